// What can be calibrated, in the order in which one does it, and what the dialog says of each.
import type { CalibrationSessionModel } from "../link/messages";

export type Kind = CalibrationSessionModel["kind"];

interface Guided {
  title: string;
  what: string; // in the list of choices
  next: string; // on the button that leads there
  steps: string[]; // after the board is printed
  beginning: string; // until the first picture was looked at
  estimating: string;
  bars: [name: string, text: string][]; // of what is wanted, and what the station calls it
  looks: boolean; // at a board; otherwise there is none, and no picture
}

export const GUIDED: Record<Kind, Guided> = {
  camera: {
    title: "Calibrate the camera",
    what: "Camera: its lens",
    next: "camera",
    steps: [
      "Glue it onto something flat: a board, a window pane. A bent one is noticed and refused.",
      "Turn the camera's focus ring until the picture is sharp; from now on leave it.",
      "Hold the board before the camera, and do what the page says.",
    ],
    beginning: "Hold the board before the camera",
    estimating: "The camera is being estimated",
    bars: [
      ["flat", "flat"],
      ["near", "near"],
      ["far", "far"],
      ["left", "left edge"],
      ["right", "right edge"],
      ["upper", "upper edge"],
      ["lower", "lower edge"],
    ],
    looks: true,
  },
  "camera-imu": {
    title: "Calibrate camera and IMU",
    what: "Camera and IMU: how they sit",
    next: "camera and IMU",
    steps: [
      "Calibrate the camera first: its lens must be known.",
      "Fix the board to a wall, flat and in good light. It must not move.",
      "Take the robot into your hand and wave it before the board for half a minute, as the page says.",
    ],
    beginning: "Hold the robot before the board",
    estimating: "Camera and IMU are being estimated",
    bars: [
      ["tilt", "up, down"],
      ["turn", "left, right"],
      ["roll", "roll"],
      ["distance", "near, far"],
      ["time", "time"],
    ],
    looks: true,
  },
  wheels: {
    title: "Measure the wheels",
    what: "Wheels: how far a command carries",
    next: "wheels",
    steps: [
      "Calibrate the camera first: it is the judge.",
      "Hang the board at the camera's height, and put the robot a metre before it, with half a metre free all around, on the floor it will live on.",
      "Hold the buttons to drive straight on, back, and to turn on the spot, as the page says. Let it rest two seconds after each.",
    ],
    beginning: "Put the robot before the board",
    estimating: "The wheels are being measured",
    bars: [
      ["forth", "straight on"],
      ["back", "straight back"],
      ["left", "turns left"],
      ["right", "turns right"],
    ],
    looks: true,
  },
  imu: {
    title: "Measure the IMU",
    what: "IMU: its noise at rest",
    next: "IMU",
    steps: [
      "Switch the robot on ten minutes before: a cold sensor drifts.",
      "Put it on the floor or a heavy table, motors off, where nobody walks.",
      "Leave it alone for half an hour; a minute tells the white noise. You may close this page meanwhile.",
    ],
    beginning: "Leave the robot alone",
    estimating: "The noise is being estimated",
    bars: [["time", "at rest"]],
    looks: false,
  },
  check: {
    title: "Check the calibration",
    what: "Check: does it still fit? Without a board",
    next: "check",
    steps: [
      "Do this when the robot was knocked, or when its drives say that the calibration does not fit. The camera's lens must have been calibrated once.",
      "Take the robot into your hand where there is something to see, in good light; nothing else should move.",
      "Carry it about for half a minute: tilt it, turn it and roll it, as the page says.",
    ],
    beginning: "Take the robot into your hand",
    estimating: "The calibration is being checked",
    bars: [
      ["tilt", "up, down"],
      ["turn", "left, right"],
      ["roll", "roll"],
      ["time", "time"],
    ],
    looks: false,
  },
};

const ORDER: Kind[] = ["camera", "camera-imu", "wheels", "imu"];

export const CHOICES: [Kind, string][] = [...ORDER, "check" as const].map((kind) => [kind, GUIDED[kind].what]);

/** What is calibrated after this; null: nothing. A check stands for itself. */
export const after = (kind: Kind): Kind | null => (kind === "check" ? null : (ORDER[ORDER.indexOf(kind) + 1] ?? null));
