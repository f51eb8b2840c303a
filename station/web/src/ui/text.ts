// Numbers, times and errors in words.
export const percent = (p: number): string => `${Math.round(p * 100)} %`;

/** The beginning of a sentence. */
export const capitalised = (text: string): string => text.charAt(0).toUpperCase() + text.slice(1);

export function clock(unixS: number): string {
  return new Date(unixS * 1000).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}

/** A day, written as in the names that the station gives: 21 Nov 2026. */
export function date(unixS: number): string {
  return new Date(unixS * 1000).toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric" });
}

export function duration(s: number): string {
  const whole = Math.round(s);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

/** A running time, short: 1:05. */
export function minutes(s: number): string {
  return `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
}

/** So many of something: 1 landmark, 2,000 landmarks. */
export function count(number: number, word: string): string {
  return `${number.toLocaleString("en")} ${word}${number === 1 ? "" : "s"}`;
}

export function sentence(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
