// A wheel: the station numbers places so that neighbours are far apart on it (station/places/making/colours.py).
export const PALETTE = [
  "#f87171",
  "#fb923c",
  "#facc15",
  "#a3e635",
  "#4ade80",
  "#2dd4bf",
  "#38bdf8",
  "#7ba0ff",
  "#a48bfa",
  "#c884fc",
  "#f07af0",
  "#f472b6",
] as const;

/** The colour of the place that the station gave this number. */
export function colourOf(number: number): string {
  return PALETTE[number % PALETTE.length] ?? PALETTE[0];
}
