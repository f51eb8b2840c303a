// Reading the station's state again, without an older answer ever winning over a newer one.

/** One run at a time; asked for during a run, it runs once more. So the last answer was asked for after the last cause. */
export class Refresh {
  private running: Promise<void> | null = null;
  private again = false;

  constructor(private readonly work: () => Promise<void>) {}

  /** Resolves when an answer that was asked for from now on has been taken in. */
  ask(): Promise<void> {
    this.again = true;
    this.running ??= this.run();
    return this.running;
  }

  private async run(): Promise<void> {
    try {
      while (this.again) {
        this.again = false;
        await this.work();
      }
    } finally {
      this.running = null;
    }
  }
}
