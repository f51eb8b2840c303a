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

export const driverName = (() => {
  const known = sessionStorage.getItem("driver");
  if (known) return known;
  const device = matchMedia("(pointer: coarse)").matches ? "phone" : "laptop";
  const name = `${device} ${Math.floor(100 + Math.random() * 900)}`;
  sessionStorage.setItem("driver", name);
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

/** A WebSocket that comes back by itself. */
export class LastingSocket {
  private socket: WebSocket | null = null;
  private waitMs = 250;

  constructor(
    private readonly path: string,
    private readonly onMessage: (data: string | ArrayBuffer) => void,
    private readonly onState: (open: boolean) => void,
  ) {
    this.connect();
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
    socket.onopen = () => {
      this.waitMs = 250;
      this.onState(true);
    };
    socket.onmessage = (event) => this.onMessage(event.data);
    socket.onclose = (event) => {
      this.onState(false);
      if (event.code === REVOKED) location.reload(); // and log in anew
      setTimeout(() => this.connect(), this.waitMs);
      this.waitMs = Math.min(this.waitMs * 2, 2000);
    };
  }
}
