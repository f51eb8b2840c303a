// Navigations and maps: record, stop, build, choose, name, delete.
import { call } from "./api";
import { ask, askAll, attempt, by, duration, make, setText, show, toast } from "./dom";
import { openDrive } from "./drive_dialog";
import { openMap } from "./map_dialog";
import { Refresh } from "./refresh";
import type { BinModel, ComparisonModel, JobModel, MapModel, NavigationModel, SlamModel } from "./messages";
import { isShown } from "./robots";

export class Library {
  navigations = new Map<string, NavigationModel>();
  maps: MapModel[] = [];
  private jobs = new Map<string, JobModel>();
  private told = new Set<string>(); // navigations that an event told of since their list was asked for
  private readonly navigationList = new Refresh(() => this.fetchNavigations());
  private readonly binList = new Refresh(() => this.fetchBin());
  private readonly comparisonList = new Refresh(() => this.fetchComparisons());
  private readonly mapList = new Refresh(() => this.fetchMaps());
  private connected = false;
  onChange: () => void = () => {};
  onReplay: (navigation: NavigationModel) => Promise<void> = async () => {};
  onCompare: (id: string) => Promise<void> = async () => {};

  constructor() {
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
    by("bin-list").replaceChildren(...deleted.map((entry) => {
      const restore = () => attempt(() => call("POST", `/${entry.kind}s/${entry.id}/restore`));
      const gone = new Date(entry.gone_unix_s * 1000).toLocaleDateString();
      return make("li", {}, make("div", {}, title(entry.name), make("span", { class: "note" }, `${entry.kind} · gone for good on ${gone}`)),
        make("button", { type: "button", class: "small", "aria-label": `Restore ${entry.name}`, onclick: restore }, "Restore"));
    }));
  }

  private async fetchComparisons(): Promise<void> {
    const made = await call<ComparisonModel[]>("GET", "/comparisons");
    by("comparisons").replaceChildren(...made.slice(0, 6).map((c) => this.comparisonRow(c)));
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
    const comparison = job.result?.["comparison"];
    if (job.state === "failed") toast(`${job.title}: ${job.message}`);
    if (job.state !== "done" || typeof comparison !== "string") return;
    attempt(() => this.comparisonList.ask());
    toast(`${job.title}: done`, "Show", () => this.onCompare(comparison));
  }

  private async rename(path: string, name: string, what: string): Promise<void> {
    const wanted = await ask(`Name this ${what}`, "Save", { label: "Name", value: name });
    if (wanted && wanted !== name) await call("PATCH", path, { name: wanted });
  }

  private async removeComparison(c: ComparisonModel): Promise<void> {
    const sure = await askAll(`Delete “${c.name}”?`, "Delete", [], "For good. Both navigations stay, and can be compared again.");
    if (!sure) return;
    await call("DELETE", `/comparisons/${c.id}`);
    await this.comparisonList.ask();
  }

  private async remove(path: string, name: string): Promise<void> {
    await call("DELETE", path);
    toast(`${name} is deleted.`, "Undo", () => call("POST", `${path}/restore`));
  }

  private draw(): void {
    const running = this.recording;
    const record = by<HTMLButtonElement>("record");
    record.classList.toggle("on", Boolean(running));
    record.disabled = !running && !this.connected;
    setText(record.querySelector<HTMLElement>(".text")!, running ? `Stop recording (${duration(running.duration_s)})` : "Record");
    show(by("rec"), Boolean(running));
    by("jobs").replaceChildren(...[...this.jobs.values()].filter((j) => j.state === "running").map((j) => this.jobRow(j)));
    const drives = [...this.navigations.values()].filter((n) => n.state !== "recording").reverse();
    by("navigations").replaceChildren(...drives.slice(0, 12).map((n) => this.navigationRow(n)));
    by("maps").replaceChildren(...this.maps.map((m) => this.mapRow(m)));
    this.onChange();
  }

  private jobRow(job: JobModel): HTMLElement {
    const cancel = make("button", { type: "button", class: "small", onclick: () => attempt(() => call("DELETE", `/jobs/${job.id}`)) }, "Cancel");
    const bar = make("progress", { max: "1", value: String(job.progress), "aria-label": job.title });
    return make("div", { class: "job" }, make("p", {}, `${job.title}: ${job.message}`), make("div", { class: "row" }, bar, cancel));
  }

  private navigationRow(n: NavigationModel): HTMLElement {
    const about =
      n.state === "ready" ? `${duration(n.duration_s)} · ${n.landmarks.toLocaleString()} landmarks` :
      n.state === "finishing" ? "computing trajectory and landmarks…" : n.message;
    const actions = make("div", { class: "row" });
    if (n.state === "ready")
      actions.append(make("button", { type: "button", class: "small", onclick: () => attempt(() => this.build(n)) }, "Build map"));
    if (n.state !== "finishing")
      actions.append(
        make("button", { type: "button", class: "small", "aria-label": `More about ${n.name}`, onclick: () => this.openDrive(n) }, "More"),
        this.deleteButton(`/navigations/${n.id}`, n.name),
      );
    return make("li", { class: n.state }, make("div", {}, title(n.name), make("span", { class: "note" }, about)), actions);
  }

  private mapRow(m: MapModel): HTMLElement {
    const actions = make("div", { class: "row" });
    const use = (id: string | null) => call("PUT", "/maps/active", { id });
    if (m.active) actions.append(make("span", { class: "tick" }, "in use"));
    else if (!m.damaged)
      actions.append(make("button", { type: "button", class: "small", "aria-label": `Use ${m.name}`, onclick: () => attempt(() => use(m.id)) }, "Use"));
    if (!m.damaged) {
      const more = () => openMap(m, { use, rename: () => this.rename(`/maps/${m.id}`, m.name, "map") });
      actions.append(make("button", { type: "button", class: "small", "aria-label": `More about ${m.name}`, onclick: more }, "More"));
    }
    if (!m.active) actions.append(this.deleteButton(`/maps/${m.id}`, m.name));
    const about = m.damaged || `map · ${m.places} places`;
    return make("li", { class: m.damaged ? "failed" : m.active ? "in-use" : "" }, make("div", {}, title(m.name), make("span", { class: "note" }, about)), actions);
  }

  private openDrive(n: NavigationModel): void {
    const others = [...this.navigations.values()].filter((other) => other.id !== n.id && other.state === "ready");
    const path = `/navigations/${n.id}`;
    openDrive(n, others, { replay: this.onReplay, remove: () => this.remove(path, n.name), rename: () => this.rename(path, n.name, "navigation") });
  }

  private comparisonRow(c: ComparisonModel): HTMLElement {
    const look = make("button", { type: "button", class: "small", "aria-label": `Show ${c.name}`, onclick: () => attempt(() => this.onCompare(c.id)) }, "Show");
    const report = make("a", { class: "small", href: c.report, target: "_blank", rel: "noopener", "aria-label": `Report: ${c.name}` }, "Report");
    const remove = make("button", { type: "button", class: "small quiet", "aria-label": `Delete ${c.name}`, onclick: () => attempt(() => this.removeComparison(c)) }, "✕");
    const about = c.accepted ? `${c.matches} of ${c.places} places found again` : "could not be registered";
    return make("li", { class: c.accepted ? "" : "failed" }, make("div", {}, title(c.name), make("span", { class: "note" }, about)), make("div", { class: "row" }, look, report, remove));
  }

  private deleteButton(path: string, name: string): HTMLElement {
    const remove = () => attempt(() => this.remove(path, name));
    return make("button", { type: "button", class: "small quiet", "aria-label": `Delete ${name}`, onclick: remove }, "✕");
  }
}

/** The name of a row: cut where it is too long, whole when pointed at. */
function title(name: string): HTMLElement {
  return make("strong", { title: name }, name);
}
