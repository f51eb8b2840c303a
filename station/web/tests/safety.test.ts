// The rules of driving, without a browser: `npm test` here, or tests/unit/station/web/test_page_safety.py.
import assert from "node:assert/strict";
import { test } from "node:test";
import {
  type Direction,
  DriveGuard,
  INTERRUPTION,
  invitation,
  type Situation,
  SlowestSecond,
  speedShare,
  whyNotDrive,
  youDrive,
} from "../src/drive/safety";

const ALL_IS_WELL: Situation = {
  mayDrive: true,
  isConnected: true,
  robot: { drive: true, camera: true },
  dialogIsOpen: false,
  listIsOpen: false,
  pictureAgeMs: 60,
};
const FORWARD: Direction = [0, 1];

/** Hands, robot and page around a guard; what the guard does to them is noted in order. */
class Cockpit {
  direction: Direction | null = null;
  isHeard = true;
  readonly done: string[] = [];
  readonly guard = new DriveGuard(this, this);

  release(): void {
    this.direction = null;
    this.done.push("release");
  }

  drive([x, y]: Direction): boolean {
    this.done.push(`drive ${x} ${y}`);
    return this.isHeard;
  }

  stop(reason: string): void {
    this.done.push(`stop ${reason}`.trim());
  }

  say(text: string): void {
    this.done.push(`say ${text}`);
  }

  /** Hold forward until the robot drives, and forget how that went. */
  setGoing(): this {
    this.direction = FORWARD;
    this.guard.tick(ALL_IS_WELL);
    this.done.length = 0;
    return this;
  }
}

void test("a robot drives while something is held, and stops when it is let go", () => {
  const cockpit = new Cockpit();
  cockpit.guard.tick(ALL_IS_WELL);
  assert.deepEqual(cockpit.done, []);
  cockpit.direction = FORWARD;
  cockpit.guard.tick(ALL_IS_WELL);
  cockpit.guard.tick(ALL_IS_WELL);
  assert.equal(cockpit.guard.isDriving, true);
  cockpit.direction = null;
  cockpit.guard.tick(ALL_IS_WELL);
  cockpit.guard.tick(ALL_IS_WELL);
  assert.deepEqual(cockpit.done, ["drive 0 1", "drive 0 1", "stop"]);
  assert.equal(cockpit.guard.isDriving, false);
});

void test("a stick held in its middle is held: the robot is told to stand", () => {
  const cockpit = new Cockpit();
  cockpit.direction = [0, 0];
  cockpit.guard.tick(ALL_IS_WELL);
  assert.deepEqual(cockpit.done, ["drive 0 0"]);
});

const DOUBTS: [string, Partial<Situation>][] = [
  ["your token may only watch", { mayDrive: false }],
  ["no robot is connected", { isConnected: false }],
  ["no robot is connected", { robot: null }],
  ["a dialog is open", { dialogIsOpen: true }],
  ["a list is being chosen from", { listIsOpen: true }],
  ["no picture of the robot has come yet", { pictureAgeMs: Infinity }],
  ["the picture is 0.6 s old", { pictureAgeMs: 600 }],
];

for (const [why, change] of DOUBTS) {
  const doubtful = { ...ALL_IS_WELL, ...change };

  void test(`nothing is driven while ${why} (${Object.keys(change).join()})`, () => {
    assert.equal(whyNotDrive(doubtful), why);
    const cockpit = new Cockpit();
    cockpit.direction = FORWARD;
    cockpit.guard.tick(doubtful);
    // No STOP: what moves may be another one's.
    assert.deepEqual(cockpit.done, ["release", `say Stopped: ${why}`]);
  });

  void test(`a drive ends when ${why} (${Object.keys(change).join()})`, () => {
    const cockpit = new Cockpit().setGoing();
    cockpit.guard.tick(doubtful);
    assert.deepEqual(cockpit.done, ["release", `stop ${why}`, `say Stopped: ${why}`]);
    cockpit.guard.tick(ALL_IS_WELL);
    assert.equal(cockpit.done.length, 3, "it must be held anew");
  });
}

void test("a picture of half a second is good enough, and a robot without a camera needs none", () => {
  assert.equal(whyNotDrive({ ...ALL_IS_WELL, pictureAgeMs: 500 }), "");
  assert.equal(whyNotDrive({ ...ALL_IS_WELL, robot: { drive: true, camera: false }, pictureAgeMs: Infinity }), "");
});

for (const why of Object.values(INTERRUPTION)) {
  void test(`an interruption stops what we drive and lets go: ${why}`, () => {
    const cockpit = new Cockpit().setGoing();
    cockpit.guard.halt(why);
    assert.deepEqual(cockpit.done, ["release", `stop ${why}`, `say Stopped: ${why}`]);
    assert.equal(cockpit.guard.isDriving, false);
  });
}

void test("an interruption while nothing is held lets go in silence", () => {
  const cockpit = new Cockpit();
  cockpit.guard.halt(INTERRUPTION.windowLeft);
  assert.deepEqual(cockpit.done, ["release"]); // a gamepad that is held must come to rest first
});

void test("a refused command stops nobody: another one may be driving", () => {
  const cockpit = new Cockpit().setGoing();
  cockpit.guard.refuse("anna drives");
  assert.deepEqual(cockpit.done, ["release", "say Stopped: anna drives"]);
  assert.equal(cockpit.guard.isDriving, false);
});

void test("a command that does not go out ends the drive", () => {
  const cockpit = new Cockpit().setGoing();
  cockpit.isHeard = false;
  cockpit.guard.tick(ALL_IS_WELL);
  const why = INTERRUPTION.stationSilent;
  assert.deepEqual(cockpit.done, ["drive 0 1", "release", `stop ${why}`, `say Stopped: ${why}`]);
});

void test("the page says beforehand why nobody can drive", () => {
  assert.equal(invitation(ALL_IS_WELL), "Hold to drive");
  assert.equal(invitation({ ...ALL_IS_WELL, pictureAgeMs: 600 }), "Hold to drive"); // may be a hiccup
  assert.equal(invitation({ ...ALL_IS_WELL, pictureAgeMs: 1501 }), "No driving: the picture is old");
  assert.equal(invitation({ ...ALL_IS_WELL, robot: { drive: false, camera: true } }), "This robot cannot drive");
  assert.equal(invitation({ ...ALL_IS_WELL, isConnected: false }), "No robot");
});

void test("a slow network slows the robot: it goes no farther unseen than by sight", () => {
  assert.equal(speedShare(60, 5), 1);
  assert.equal(speedShare(200, 50), 1);
  assert.equal(speedShare(400, 100), 0.5);
  for (const late of [300, 400, 500]) assert.ok(speedShare(late, 0) * late <= 250);
});

void test("what slows the robot is named, and no network where it is the computer or the page", () => {
  assert.equal(youDrive(0.95, null), "You drive");
  assert.equal(youDrive(0.5, { grade: "bad", computer_busy: false }), "You drive, slowed to 50 %: the network is slow");
  assert.equal(
    youDrive(0.5, { grade: "bad", computer_busy: true }),
    "You drive, slowed to 50 %: the station's computer is busy",
  );
  assert.equal(
    youDrive(0.5, { grade: "good", computer_busy: false }),
    "You drive, slowed to 50 %: pictures come late to this page",
  );
});

void test("the slowest second counts, and is forgotten", () => {
  const ages = new SlowestSecond();
  assert.equal(ages.note(400, 0), 400);
  assert.equal(ages.note(100, 900), 400);
  assert.equal(ages.note(100, 1001), 100);
});
