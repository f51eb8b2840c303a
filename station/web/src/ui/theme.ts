// Light or dark: as the person chose, else as their system is. Before anything is asked, so the login is in it too.
import { by } from "./dom";

const light = matchMedia("(prefers-color-scheme: light)");

export function dress(): void {
  by("theme").addEventListener("click", () => {
    const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
    localStorage.setItem("theme", dark ? "light" : "dark");
    show();
  });
  light.addEventListener("change", show);
  show();
}

function show(): void {
  document.documentElement.dataset.theme = localStorage.getItem("theme") ?? (light.matches ? "light" : "dark");
}
