// What can be taken back: the newest change of places or rooms, and the one that is just being made.
import { ApiError, call } from "../link/api";
import type { PlacesChangeModel } from "../link/messages";
import { Refresh } from "../link/refresh";
import { by, setText, show } from "../ui/dom";
import { attempt, toast } from "../ui/toast";

/** A change that this page is making. */
interface Making {
  isUnwanted: boolean; // Undo was pressed before it was made
}

export class LastChange {
  private map: string | null = null;
  private changes: PlacesChangeModel[] = []; // newest first
  private making: Making | null = null;
  private readonly beingTakenBack = new Set<string>();
  private readonly list = new Refresh(() => this.read());

  constructor() {
    by("undo-places").addEventListener("click", () => this.press());
  }

  /** The map in use is another one, or changed; null: there is none. */
  showMap(id: string | null): Promise<void> {
    if (id !== this.map) this.changes = []; // of another map
    this.map = id;
    return this.list.ask();
  }

  /** Make a change, and offer for a while to take just that back. Undo that is pressed before it is made means it, too. */
  async make(work: () => Promise<number | null>): Promise<void> {
    const making: Making = { isUnwanted: false };
    const { map } = this;
    this.making = making;
    this.draw();
    let version: number | null = null;
    try {
      version = await work();
      await this.list.ask();
    } finally {
      if (this.making === making) this.making = null;
      this.draw();
    }
    if (map !== this.map) return; // what is listed now is another map's
    const made = this.changes.find((change) => change.version === version);
    if (!made) {
      toast(version === null ? "Nothing was changed: it was so already." : "It was taken back already.");
      return;
    }
    if (!making.isUnwanted) {
      toast(`${made.why}.`, {
        label: "Undo",
        act: async () => {
          await this.takeBack(made);
        },
      });
      return;
    }
    if (await this.takeBack(made)) toast(`Taken back: ${made.why}.`);
  }

  private press(): void {
    const { making, changes } = this;
    const [newest] = changes;
    if (making) {
      making.isUnwanted = true;
      this.draw();
    } else if (newest) attempt(() => this.takeBack(newest));
  }

  /** Just this one; whether that was done. A second press does nothing until the list says what is the newest then. */
  private async takeBack(change: PlacesChangeModel): Promise<boolean> {
    const key = `${change.map} ${change.version}`;
    if (this.beingTakenBack.has(key)) return false;
    this.beingTakenBack.add(key);
    try {
      await call("POST", "/places/undo", { version: change.version, map: change.map });
      await this.list.ask();
      return true;
    } catch (error) {
      if (!(error instanceof ApiError) || error.status !== 409) throw error;
      await this.list.ask();
      const isOfAnother = change.map !== this.map || this.changes.some((each) => each.map !== change.map);
      if (isOfAnother) toast(`Not taken back: ${change.why}. That is of another map than the one in use now.`);
      else this.tellWhatCameBetween(change);
      return false;
    } finally {
      this.beingTakenBack.delete(key);
    }
  }

  /** Somebody else was faster than the list that this page knew. */
  private tellWhatCameBetween(change: PlacesChangeModel): void {
    const [newest] = this.changes;
    if (newest && newest.version > change.version)
      toast(`Meanwhile: ${newest.why}.`, {
        label: "Undo",
        act: async () => {
          await this.takeBack(newest);
        },
      });
    else toast(`It was taken back already: ${change.why}.`);
  }

  private async read(): Promise<void> {
    const { map } = this;
    try {
      const changes = map === null ? [] : await call<PlacesChangeModel[]>("GET", "/places/changes");
      if (this.map !== map) return; // of another map, whose event asks again
      this.changes = changes;
      this.draw();
    } catch (error) {
      if (this.map === map) throw error; // of a map that is left nobody wants to know
    }
  }

  private draw(): void {
    const { making, changes } = this;
    const [newest] = changes;
    show(by("undo"), making !== null || newest !== undefined);
    const underWay = making?.isUnwanted ? "taken back as soon as it is made …" : "being made …";
    setText(by("undo-text"), making ? underWay : (newest?.why ?? ""));
  }
}
