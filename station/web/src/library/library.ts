// Navigations and maps: record, stop, build, choose, name, delete.
import { isShown } from "../link/address";
import { call } from "../link/api";
import type { BinModel, ComparisonModel, JobModel, MapModel, NavigationModel, SlamModel } from "../link/messages";
import { Refresh } from "../link/refresh";
import { askConsent, askUntil } from "../ui/dialogs";
import { by, make, setText, show, within } from "../ui/dom";
import { action, Rows } from "../ui/rows";
import { count, date, duration, minutes } from "../ui/text";
import { attempt, toast } from "../ui/toast";
import { openMap } from "./map_dialog";
import { openNavigation } from "./navigation_dialog";

export interface LibraryEvents {
  onChange: () => void;
  onReplay: (navigation: NavigationModel) => Promise<void>;
  onCompare: (id: string) => Promise<void>;
}

export class Library {
  navigations = new Map<string, NavigationModel>();
  maps: MapModel[] = [];
  private jobs = new Map<string, JobModel>();
  private told = new Set<string>(); // navigations that an event told of since their list was asked for
  private readonly navigationList = new Refresh(() => this.fetchNavigations());
  private readonly binList = new Refresh(() => this.fetchBin());
  private readonly comparisonList = new Refresh(() => this.fetchComparisons());
  private readonly mapList = new Refresh(() => this.fetchMaps());
  private readonly jobRows = new Rows<JobModel>(
    by("jobs"),
    (j) => j.id,
    (j, now) => this.jobRow(j, now),
  );
  private readonly navigationRows = new Rows<NavigationModel>(
    by("navigations"),
    (n) => n.id,
    (n, now) => this.navigationRow(n, now),
  );
  private readonly mapRows = new Rows<MapModel>(
    by("maps"),
    (m) => m.id,
    (m, now) => this.mapRow(m, now),
  );
  private readonly comparisonRows = new Rows<ComparisonModel>(
    by("comparisons"),
    (c) => c.id,
    (c, now) => this.comparisonRow(c, now),
  );
  private readonly binRows = new Rows<BinModel>(
    by("bin-list"),
    (b) => `${b.kind} ${b.id}`,
    (b, now) => this.binRow(b, now),
  );
  private connected = false;

  constructor(private readonly events: LibraryEvents) {
    by("record").addEventListener("click", () => attempt(() => this.toggleRecording()));
  }

  get recording(): NavigationModel | undefined {
    return [...this.navigations.values()].find((n) => n.state === "recording" && isShown(n.robot));
  }

  async reload(): Promise<void> {
    await Promise.all([this.navigationList.ask(), this.mapList.ask(), this.comparisonList.ask()]);
  }

  reloadNavigations(): Promise<void> {
    return this.navigationList.ask();
  }

  reloadMaps(): Promise<void> {
    return this.mapList.ask();
  }

  reloadBin(): Promise<void> {
    return this.binList.ask();
  }

  private async fetchBin(): Promise<void> {
    const deleted = await call<BinModel[]>("GET", "/bin");
    show(by("bin"), deleted.length > 0);
    setText(by("bin-summary"), `Recently deleted (${deleted.length})`);
    this.binRows.show(deleted);
  }

  private async fetchComparisons(): Promise<void> {
    const made = await call<ComparisonModel[]>("GET", "/comparisons");
    this.comparisonRows.show(made.slice(0, 6));
  }

  private async fetchNavigations(): Promise<void> {
    this.told.clear();
    const listed = await call<NavigationModel[]>("GET", "/navigations");
    const newer = [...this.navigations.values()].filter((n) => this.told.has(n.id));
    this.navigations = new Map([...listed, ...newer].map((n) => [n.id, n]));
    this.draw();
  }

  private async fetchMaps(): Promise<void> {
    this.maps = await call<MapModel[]>("GET", "/maps");
    this.draw();
  }

  setConnected(connected: boolean): void {
    if (connected === this.connected) return;
    this.connected = connected;
    this.draw();
  }

  update(navigation: NavigationModel): void {
    this.told.add(navigation.id);
    this.navigations.set(navigation.id, navigation);
    this.draw();
  }

  updateJob(job: JobModel): void {
    const before = this.jobs.get(job.id);
    this.jobs.set(job.id, job);
    if (before?.state === "running") this.tellEnd(job);
    this.draw();
  }

  showSlam(slam: SlamModel): void {
    const busy = slam.state !== "none" && slam.state !== "finished";
    setText(by("slam"), busy ? slam.message : "");
  }

  private async toggleRecording(): Promise<void> {
    const running = this.recording;
    // The answer is not shown: events tell every change, and in order.
    await call("POST", running ? `/navigations/${running.id}/stop` : "/navigations", running ? undefined : {});
  }

  private async build(navigation: NavigationModel): Promise<void> {
    await call("POST", "/maps", { navigations: [navigation.id], name: `Map of ${navigation.name}` });
  }

  private tellEnd(job: JobModel): void {
    const comparison = job.result?.comparison;
    if (job.state === "failed") toast(`${job.title}: ${job.message}`);
    if (job.state !== "done" || typeof comparison !== "string") return;
    attempt(() => this.comparisonList.ask());
    toast(`${job.title}: done`, { label: "Show", act: () => this.events.onCompare(comparison) });
  }

  private async rename(path: string, name: string, what: string): Promise<void> {
    const save = async (wanted: string) => {
      if (wanted !== name) await call("PATCH", path, { name: wanted });
    };
    await askUntil(`Name this ${what}`, "Save", { label: "Name", value: name }, save);
  }

  private async removeComparison(c: ComparisonModel): Promise<void> {
    const sure = await askConsent(
      `Delete “${c.name}”?`,
      "Delete",
      "For good. Both navigations stay, and can be compared again.",
    );
    if (!sure) return;
    await call("DELETE", `/comparisons/${c.id}`);
    await this.comparisonList.ask();
  }

  private async remove(path: string, name: string): Promise<void> {
    await call("DELETE", path);
    toast(`${name} is deleted.`, { label: "Undo", act: () => call("POST", `${path}/restore`) });
  }

  private draw(): void {
    const running = this.recording;
    const record = by("record", HTMLButtonElement);
    record.classList.toggle("on", Boolean(running));
    record.disabled = !running && !this.connected;
    setText(within(record, ".text"), running ? `Stop recording · ${minutes(running.duration_s)}` : "Record");
    show(by("rec"), Boolean(running));
    this.jobRows.show([...this.jobs.values()].filter((j) => j.state === "running"));
    const ended = [...this.navigations.values()].filter((n) => n.state !== "recording").reverse();
    this.navigationRows.show(ended.slice(0, 12));
    this.mapRows.show(this.maps);
    this.events.onChange();
  }

  private jobRow(job: JobModel, now: () => JobModel): HTMLElement {
    const cancel = action("cancel", "Cancel", `Cancel: ${job.title}`, () =>
      attempt(() => call("DELETE", `/jobs/${now().id}`)),
    );
    const bar = make("progress", { max: "1", value: String(job.progress), "aria-label": job.title });
    return make(
      "div",
      { class: "job" },
      make("p", {}, `${job.title}: ${job.message}`),
      make("div", { class: "row" }, bar, cancel),
    );
  }

  private navigationRow(n: NavigationModel, now: () => NavigationModel): HTMLElement {
    const about = n.state === "ready" ? `${duration(n.duration_s)} · ${count(n.landmarks, "landmark")}` : n.message;
    const actions = make("div", { class: "row" });
    if (n.state === "ready") actions.append(action("build", "Build map", "", () => attempt(() => this.build(now()))));
    if (n.state === "finishing")
      actions.append(action("cancel", "Cancel", `Cancel finishing ${n.name}`, () => attempt(() => this.cancel(now()))));
    else
      actions.append(
        action("more", "More", `More about ${n.name}`, () => this.openNavigation(now())),
        this.deleteButton(n.name, () => [`/navigations/${now().id}`, now().name]),
      );
    return make(
      "li",
      { class: n.state },
      make("div", {}, title(n.name), make("span", { class: "note" }, about)),
      actions,
    );
  }

  private async cancel(n: NavigationModel): Promise<void> {
    const note = "The recording is kept: SLAM can run over it again.";
    if (await askConsent(`Cancel finishing “${n.name}”?`, "Cancel finishing", note, "Go on"))
      await call("POST", `/navigations/${n.id}/cancel`);
  }

  private mapRow(m: MapModel, now: () => MapModel): HTMLElement {
    const actions = make("div", { class: "row" });
    const use = (id: string | null) => call("PUT", "/maps/active", { id });
    if (m.active) actions.append(make("span", { class: "tick" }, m.first ? "in use" : "also in use"));
    else if (!m.damaged) actions.append(action("use", "Use", `Use ${m.name}`, () => attempt(() => use(now().id))));
    if (!m.damaged) {
      const more = () => openMap(now(), { use, rename: () => this.rename(`/maps/${now().id}`, now().name, "map") });
      actions.append(action("more", "More", `More about ${m.name}`, more));
    }
    if (!m.active) actions.append(this.deleteButton(m.name, () => [`/maps/${now().id}`, now().name]));
    const about = [m.damaged || `map · ${count(m.places, "place")}`, m.misfit].filter(Boolean).join(" · ");
    return make(
      "li",
      { class: m.damaged ? "failed" : m.active ? "in-use" : "" },
      make("div", {}, title(m.name), make("span", { class: "note" }, about)),
      actions,
    );
  }

  private binRow(entry: BinModel, now: () => BinModel): HTMLElement {
    const restore = () => attempt(() => call("POST", `/${now().kind}s/${now().id}/restore`));
    const about = `${entry.kind} · gone for good on ${date(entry.gone_unix_s)}`;
    return make(
      "li",
      {},
      make("div", {}, title(entry.name), make("span", { class: "note" }, about)),
      action("restore", "Restore", `Restore ${entry.name}`, restore),
    );
  }

  private openNavigation(n: NavigationModel): void {
    const others = [...this.navigations.values()].filter((other) => other.id !== n.id && other.state === "ready");
    const path = `/navigations/${n.id}`;
    openNavigation(n, others, {
      replay: this.events.onReplay,
      remove: () => this.remove(path, n.name),
      rename: () => this.rename(path, n.name, "navigation"),
    });
  }

  private comparisonRow(c: ComparisonModel, now: () => ComparisonModel): HTMLElement {
    const look = action("show", "Show", `Show ${c.name}`, () => attempt(() => this.events.onCompare(now().id)));
    const report = make(
      "a",
      { class: "small", href: c.report, target: "_blank", rel: "noopener", "aria-label": `Report: ${c.name}` },
      "Report",
    );
    const remove = action(
      "delete",
      "✕",
      `Delete ${c.name}`,
      () => attempt(() => this.removeComparison(now())),
      "quiet",
    );
    const about = c.accepted ? `${c.matches} of ${c.places} places found again` : "could not be registered";
    return make(
      "li",
      { class: c.accepted ? "" : "failed" },
      make("div", {}, title(c.name), make("span", { class: "note" }, about)),
      make("div", { class: "row" }, look, report, remove),
    );
  }

  private deleteButton(name: string, what: () => [string, string]): HTMLElement {
    return action("delete", "✕", `Delete ${name}`, () => attempt(() => this.remove(...what())), "quiet");
  }
}

/** The name of a row: cut where it is too long, whole when pointed at. */
function title(name: string): HTMLElement {
  return make("strong", { title: name }, name);
}
