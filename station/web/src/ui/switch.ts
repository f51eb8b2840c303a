/** Buttons side by side of which one is pressed: those with `data-NAME`. */
export class Switch {
  private readonly buttons: HTMLElement[];

  constructor(
    private readonly name: string,
    onPress: (value: string) => void,
  ) {
    this.buttons = [...document.querySelectorAll<HTMLElement>(`[data-${name}]`)];
    for (const button of this.buttons) button.addEventListener("click", () => onPress(this.valueOf(button)));
  }

  show(value: string): void {
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(this.valueOf(button) === value));
  }

  private valueOf(button: HTMLElement): string {
    return button.dataset[this.name] ?? "";
  }
}
