// The WebSocket that takes driving commands.
import { driverName } from "../link/driver_name";
import type { DriveAnswer, DriveRequest } from "../link/messages";
import { LastingSocket } from "../link/socket";

const TTL_MS = 200; // the page's silence becomes a stop within this, whatever happens to it

export interface LineEvents {
  onLost: () => void;
  onDriver: (driver: string | null) => void;
  onAccepted: (seq: number) => void;
  onRefused: (text: string) => void;
}

export class DriveLine {
  private readonly socket: LastingSocket;
  private seq = 0;
  private heardMs: number | null = null; // the station's clock: shows that a command is not old when it arrives

  constructor(private readonly events: LineEvents) {
    this.socket = new LastingSocket(`/ws/drive?driver=${encodeURIComponent(driverName)}`, {
      onMessage: (data) => this.take(JSON.parse(data as string) as DriveAnswer),
      onState: (open) => {
        this.heardMs = null; // of another station, perhaps
        if (!open) this.events.onLost();
      },
    });
  }

  /** The number of the newest command. */
  get newestSeq(): number {
    return this.seq;
  }

  /** Hold this velocity (m/s forward, rad/s left) for a moment. False: the command did not go out. */
  drive(linear: number, angular: number): boolean {
    this.seq += 1;
    return this.send({ type: "drive", seq: this.seq, linear, angular, ttl_ms: TTL_MS, heard_ms: this.heardMs });
  }

  send(request: DriveRequest): boolean {
    return this.socket.send(JSON.stringify(request));
  }

  private take(answer: DriveAnswer): void {
    switch (answer.type) {
      case "time":
        this.heardMs = answer.t_ms;
        break;
      case "accepted":
        this.events.onAccepted(answer.seq);
        break;
      case "driver":
        this.events.onDriver(answer.driver);
        break;
      case "refused":
        this.events.onRefused(answer.text);
        break;
    }
  }
}
