// Calls of the station's API. Errors are problem documents; their sentence is shown as it is.
import type { Problem } from "./messages";
import { toRobot } from "./robots";

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly kind: string,
    text: string,
  ) {
    super(text);
  }
}

/**
 * The name this tab drives under; a reload keeps it. It is not in the store while the page is open, since a duplicated tab
 * begins with a copy of that, and two tabs of one name would be one driver: what one stops, the other could go on with.
 */
export const driverName = (() => {
  const known = sessionStorage.getItem("driver");
  sessionStorage.removeItem("driver");
  const device = matchMedia("(pointer: coarse)").matches ? "phone" : "laptop";
  const name = known ?? `${device} ${Math.floor(100 + Math.random() * 900)}`;
  addEventListener("pagehide", () => sessionStorage.setItem("driver", name));
  addEventListener("pageshow", () => sessionStorage.removeItem("driver")); // back from where browsers keep closed pages
  return name;
})();

async function request(method: string, path: string, body?: unknown): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(toRobot(path, method), {
      method,
      headers: { "X-Driver": driverName, ...(body === undefined ? {} : { "Content-Type": "application/json" }) },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch {
    throw new ApiError(0, "unreachable", "the station does not answer");
  }
  if (answer.ok) return answer;
  const problem = (await answer.json().catch(() => ({}))) as Partial<Problem>;
  throw new ApiError(answer.status, problem.type ?? "", problem.detail ?? answer.statusText);
}

export async function call<T>(method: string, path: string, body?: unknown): Promise<T> {
  const answer = await request(method, path, body);
  return (answer.status === 204 ? null : await answer.json()) as T;
}

export async function fetchBytes(path: string): Promise<{ bytes: ArrayBuffer; source: string }> {
  const answer = await request("GET", path);
  return { bytes: await answer.arrayBuffer(), source: answer.headers.get("X-Source") ?? "" };
}

export function socketUrl(path: string): string {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${toRobot(path)}`;
}

const REVOKED = 4401; // station/api/doorkeeper.py

const LONGEST_WAIT_MS = 1000;
const SILENT_MS = 1250; // the station's events come every second
const PATIENCE_MS = 1500; // with a connection that does not open
const GRACE_MS = 400; // for the first word after the network was away
const sockets: LastingSocket[] = [];
let resumedMs = -Infinity; // when the steady socket came back after it had been lost

/** A WebSocket that comes back by itself, within two seconds after the network does. */
export class LastingSocket {
  private socket: WebSocket | null = null;
  private probe: WebSocket | null = null;
  private waitMs = 250;
  private begunMs = 0;
  private heardMs = 0;
  private wasOpen = false;

  /** `isSteady`: something comes every second, so that silence means something. */
  constructor(
    private readonly path: string,
    private readonly onMessage: (data: string | ArrayBuffer) => void,
    private readonly onState: (open: boolean) => void,
    private readonly isSteady = false,
  ) {
    sockets.push(this);
    this.connect();
    setInterval(() => this.look(), 250);
  }

  get isOpen(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  send(data: string): boolean {
    if (!this.isOpen) return false;
    this.socket!.send(data);
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
      if (this.isSteady && this.wasOpen) resumedMs = this.heardMs;
      this.wasOpen = true;
      this.onState(true);
    };
    socket.onmessage = (event) => {
      this.heardMs = performance.now();
      this.onMessage(event.data);
    };
    socket.onclose = (event) => {
      this.onState(false);
      if (event.code === REVOKED) location.reload(); // and log in anew
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
    this.onState(false);
    this.connect();
  }

  private look(): void {
    const nowMs = performance.now();
    if (this.socket?.readyState === WebSocket.CONNECTING && nowMs - this.begunMs > PATIENCE_MS) this.renew();
    const isSilent = this.isSteady && this.isOpen && nowMs - this.heardMs > SILENT_MS;
    if (isSilent && this.probe === null) this.tryAnother();
    // The steady one was told that it ended. What has said nothing since may have ended too, and was not told.
    if (this.isOpen && this.heardMs < resumedMs && nowMs - resumedMs > GRACE_MS) this.renew();
  }

  /**
   * Silence may be a station or a network that is slow just now: then another connection gets no word either. When it
   * does while this one stays silent, neither end was told that the old ones are dead.
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
