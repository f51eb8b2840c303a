// Drives and maps: record, stop, build, choose, delete.
import { call } from "./api";
import { ask, attempt, by, duration, make, setText, show } from "./dom";
import { Refresh } from "./refresh";
import type { JobModel, MapModel, NavigationModel, SlamModel } from "./messages";

export class Library {
  navigations = new Map<string, NavigationModel>();
  maps: MapModel[] = [];
  private jobs = new Map<string, JobModel>();
  private told = new Set<string>(); // navigations that an event told of since their list was asked for
  private readonly navigationList = new Refresh(() => this.fetchNavigations());
  private readonly mapList = new Refresh(() => this.fetchMaps());
  private connected = false;
  onChange: () => void = () => {};

  constructor() {
    by("record").addEventListener("click", () => attempt(() => this.toggleRecording()));
  }

  get recording(): NavigationModel | undefined {
    return [...this.navigations.values()].find((n) => n.state === "recording");
  }

  async reload(): Promise<void> {
    await Promise.all([this.navigationList.ask(), this.mapList.ask()]);
  }

  reloadNavigations(): Promise<void> {
    return this.navigationList.ask();
  }

  reloadMaps(): Promise<void> {
    return this.mapList.ask();
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
    this.jobs.set(job.id, job);
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

  private async remove(path: string, name: string): Promise<void> {
    if (await ask(`Delete ${name}? Its files are gone then.`, "Delete")) await call("DELETE", path);
    await this.reload();
  }

  private draw(): void {
    const running = this.recording;
    const record = by<HTMLButtonElement>("record");
    record.classList.toggle("on", Boolean(running));
    record.disabled = !running && !this.connected;
    setText(record.querySelector<HTMLElement>(".text")!, running ? `Stop recording (${duration(running.duration_s)})` : "Record a drive");
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
    if (n.recording) actions.append(make("a", { class: "small", href: n.recording, download: true, "aria-label": `Download ${n.name}` }, "MCAP"));
    if (n.state !== "finishing")
      actions.append(this.deleteButton(`/navigations/${n.id}`, n.name));
    return make("li", { class: n.state }, make("div", {}, make("strong", {}, n.name), make("span", { class: "note" }, about)), actions);
  }

  private mapRow(m: MapModel): HTMLElement {
    const actions = make("div", { class: "row" });
    if (m.active) actions.append(make("span", { class: "tick" }, "in use"));
    else if (!m.damaged) {
      const use = () => attempt(() => call("PUT", "/maps/active", { id: m.id }));
      actions.append(make("button", { type: "button", class: "small", onclick: use }, "Use"));
    }
    if (!m.active) actions.append(this.deleteButton(`/maps/${m.id}`, m.name));
    const about = m.damaged || `map · ${m.places} places`;
    return make("li", { class: m.damaged ? "failed" : m.active ? "in-use" : "" }, make("div", {}, make("strong", {}, m.name), make("span", { class: "note" }, about)), actions);
  }

  private deleteButton(path: string, name: string): HTMLElement {
    const remove = () => attempt(() => this.remove(path, name));
    return make("button", { type: "button", class: "small quiet", "aria-label": `Delete ${name}`, onclick: remove }, "✕");
  }
}
