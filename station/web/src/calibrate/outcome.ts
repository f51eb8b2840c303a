// What wheels and IMU came to.
import type { CalibrationSessionModel, FactorResult, FigureResult, ImuResult, WheelsResult } from "../link/messages";
import { make, present } from "../ui/dom";
import { fixed, residualsOf, row, verdictOf } from "./parts";

const FIGURES: [
  key: "gyro_noise_density" | "gyro_random_walk" | "accel_noise_density" | "accel_random_walk",
  text: string,
][] = [
  ["gyro_noise_density", "gyroscope, white"],
  ["gyro_random_walk", "gyroscope, walk"],
  ["accel_noise_density", "accelerometer, white"],
  ["accel_random_walk", "accelerometer, walk"],
];
const MRAD = 1000;

/** How far a command carries. */
export function wheelsOf(session: CalibrationSessionModel, result: WheelsResult): (Node | string)[] {
  const { speed, turn } = result;
  return present(
    ...verdictOf(result),
    (speed ?? turn) &&
      make(
        "dl",
        { class: "health numbers" },
        ...(speed ? row("forward", factor(speed, "straight ways")) : []),
        ...(turn ? row("turning", factor(turn, "turns")) : []),
        ...(result.lag_s === null ? [] : row("motors answer", `${fixed(2 * result.lag_s, 2)} s late`)),
      ),
    (speed ?? turn) && residualsOf(session, "What came of each commanded way and turn"),
  );
}

const factor = (f: FactorResult, of: string): string =>
  `${fixed(100 * f.value, 1)} ± ${fixed(100 * f.sigma, 1)} % of what is commanded, from ${f.moves} ${of}`;

/** How much it reads at rest. */
export function imuOf(session: CalibrationSessionModel, result: ImuResult): (Node | string)[] {
  const errors = result.accelerometer;
  return present(
    ...verdictOf(result),
    result.gyro_noise_density &&
      make(
        "dl",
        { class: "health numbers" },
        ...FIGURES.flatMap(([key, text]) => row(text, figure(result[key]))),
        ...(errors ? row("scale", errors.scale.map((s) => s.toFixed(4)).join(", ")) : []),
        ...(errors ? row("bias", `${errors.bias.map((b) => b.toFixed(3)).join(", ")} m/s²`) : []),
        ...(errors?.misalignment
          ? row("misalignment", `${errors.misalignment.map((a) => (MRAD * a).toFixed(1)).join(", ")} mrad`)
          : []),
      ),
    result.gyro_noise_density && residualsOf(session, "The Allan deviation, with the noise that was fitted"),
    ...result.notes.map((note) => make("p", { class: "note" }, note)),
  );
}

function figure(f: FigureResult | null): string {
  if (!f) return "?";
  const [low = NaN, high = NaN] = f.interval;
  const ends = `${low.toExponential(2)} to ${high.toExponential(2)}`;
  if (f.value === null) return `${low > 0 ? ends : `at most ${high.toExponential(2)}`} ${f.unit}`;
  return `${f.value.toExponential(2)} (${ends}) ${f.unit}`;
}
