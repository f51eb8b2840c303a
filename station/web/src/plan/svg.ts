// Elements of a drawing.

/** An SVG element with these attributes. */
export function draw<K extends keyof SVGElementTagNameMap>(
  tag: K,
  attributes: Record<string, string | number> = {},
  ...children: (Node | string)[]
): SVGElementTagNameMap[K] {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, String(value));
  node.append(...children);
  return node;
}

/** A closed line through points. */
export function closedPath(points: Point[]): string {
  return `M${points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}Z`;
}

/** Selects what has this value for this kind of data. */
export function withData(kind: string, value: string): string {
  return `[data-${kind}="${CSS.escape(value)}"]`;
}

export type Point = [number, number];
