// What the calibration of camera and IMU came to.
import type { CalibrationSessionModel, MountingResult } from "../link/messages";
import { make, present } from "../ui/dom";
import { fixed, residualsOf, row, verdictOf } from "./parts";

const MM = 1000;
const MS = 1000;
const US = 1e6;

/** Where the camera sits, when it sees, and what is left over. */
export function mountingOf(session: CalibrationSessionModel, result: MountingResult): (Node | string)[] {
  const { sigma, T_body_cam: T } = result;
  return present(
    ...verdictOf(result),
    sigma &&
      T &&
      make(
        "dl",
        { class: "health numbers" },
        ...row("turned", `known to ± ${fixed(Math.max(...sigma.rotation_deg), 3)}°`),
        ...["forward", "left", "up"].flatMap((name, i) =>
          row(name, plusMinus(T[i]?.[3], sigma.translation_m[i], MM, 1, "mm from the IMU")),
        ),
        ...row("time shift", plusMinus(result.time_shift_s, sigma.time_shift_s, MS, 2, "ms")),
        ...row("line delay", plusMinus(result.line_delay_s, sigma.line_delay_s, US, 2, "µs")),
        ...row("left over", `${fixed(result.rms_px, 2)} px rms, ${fixed(result.rms_accel, 3)} m/s²`),
      ),
    sigma && residualsOf(session, "What is left over of each corner in the picture, and of the IMU over time"),
    ...result.notes.map((note) => make("p", { class: "note" }, note)),
  );
}

function plusMinus(
  value: number | null | undefined,
  sigma: number | undefined,
  scale: number,
  digits: number,
  unit: string,
): string {
  return `${fixed((value ?? NaN) * scale, digits)} ± ${fixed((sigma ?? NaN) * scale, digits)} ${unit}`;
}
