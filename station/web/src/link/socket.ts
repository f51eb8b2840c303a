// WebSockets to the station that come back by themselves.
import { socketUrl } from "./address";

const REVOKED = 4401; // station/api/doorkeeper.py
const REPLACED = 4409; // station/api/limits.py

const LONGEST_WAIT_MS = 1000;
const REPLACED_WAIT_MS = 10_000;
const SILENT_MS = 1250; // the station's events come every second
const PATIENCE_MS = 1500; // with a connection that does not open
const GRACE_MS = 400; // for the first word after the network was away
const sockets: LastingSocket[] = [];
let resumedMs = -Infinity; // when the steady socket came back after it had been lost

export interface SocketOptions {
  onMessage: (data: string | ArrayBuffer) => void;
  onState?: (open: boolean) => void;
  /** Something comes every second, so that silence means something. */
  isSteady?: boolean;
}

/** A WebSocket that comes back by itself, within two seconds after the network does. */
export class LastingSocket {
  private socket: WebSocket | null = null;
  private probe: WebSocket | null = null;
  private waitMs = 250;
  private begunMs = 0;
  private heardMs = 0;
  private wasOpen = false;

  constructor(
    private readonly path: string,
    private readonly options: SocketOptions,
  ) {
    sockets.push(this);
    this.connect();
    setInterval(() => this.look(), 250);
  }

  get isOpen(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  send(data: string): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(data);
    return true;
  }

  private connect(): void {
    const socket = new WebSocket(socketUrl(this.path));
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.begunMs = performance.now();
    socket.onopen = () => {
      this.waitMs = 250;
      this.heardMs = performance.now();
      if (this.options.isSteady && this.wasOpen) resumedMs = this.heardMs;
      this.wasOpen = true;
      this.options.onState?.(true);
    };
    socket.onmessage = (event) => {
      this.heardMs = performance.now();
      this.options.onMessage(event.data as string | ArrayBuffer);
    };
    socket.onclose = (event) => {
      this.options.onState?.(false);
      if (event.code === REVOKED) location.reload(); // and log in anew
      // A newer page has the place: two that take it from each other without a pause would both be of no use.
      if (event.code === REPLACED) this.waitMs = REPLACED_WAIT_MS;
      setTimeout(() => this.connect(), this.waitMs);
      this.waitMs = Math.min(this.waitMs * 2, LONGEST_WAIT_MS);
    };
  }

  /** Leave the connection there is, which may be dead: a browser would wait long for its end. */
  private renew(): void {
    const socket = this.socket;
    if (socket === null || socket.readyState > WebSocket.OPEN) return; // its onclose connects
    socket.onopen = socket.onmessage = socket.onclose = null;
    socket.close();
    this.options.onState?.(false);
    this.connect();
  }

  private look(): void {
    const nowMs = performance.now();
    if (this.socket?.readyState === WebSocket.CONNECTING && nowMs - this.begunMs > PATIENCE_MS) this.renew();
    const isSilent = this.options.isSteady && this.isOpen && nowMs - this.heardMs > SILENT_MS;
    if (isSilent && this.probe === null) this.tryAnother();
    // The steady one was told that it ended. What has said nothing since may have ended too, and was not told.
    if (this.isOpen && this.heardMs < resumedMs && nowMs - resumedMs > GRACE_MS) this.renew();
  }

  /**
   * Silence may be a station or a network that is slow just now: then a second socket stays silent, too. When that one
   * hears something while this one does not, this one is dead and neither end was told.
   */
  private tryAnother(): void {
    const probe = new WebSocket(socketUrl(this.path));
    this.probe = probe;
    const begunMs = performance.now();
    const giveUp = setTimeout(() => end(), PATIENCE_MS);
    const end = () => {
      clearTimeout(giveUp);
      probe.onmessage = probe.onclose = null;
      probe.close();
      this.probe = null;
    };
    probe.onclose = end;
    probe.onmessage = () => {
      end();
      if (this.heardMs < begunMs) for (const socket of sockets) socket.renew();
    };
  }
}
