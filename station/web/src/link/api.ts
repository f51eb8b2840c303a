// Calls of the station's API. Errors are problem documents; their sentence is shown as it is.
import { toRobot } from "./address";
import { driverName } from "./driver_name";
import type { Problem } from "./messages";

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly kind: string,
    text: string,
  ) {
    super(text);
  }
}

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

/** An edit of places or rooms: the version of the map that it led to; null: it was so already. */
export async function edit(method: string, path: string, body?: unknown): Promise<number | null> {
  const { headers } = await request(method, path, body);
  const version = headers.get("X-Change-Version");
  return version === null ? null : Number(version);
}

export async function fetchBytes(path: string): Promise<{ bytes: ArrayBuffer; source: string }> {
  const answer = await request("GET", path);
  return { bytes: await answer.arrayBuffer(), source: answer.headers.get("X-Source") ?? "" };
}
