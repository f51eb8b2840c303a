// The page: parts that show, one event stream that tells them.
import { CalibrateDialog } from "./calibrate/dialog";
import { DriveControl } from "./drive/control";
import { VideoView } from "./drive/video";
import { Library } from "./library/library";
import { findMissing } from "./link/address";
import { call } from "./link/api";
import type { EventMessage, LogModel, RobotEntry } from "./link/messages";
import { LastingSocket } from "./link/socket";
import { MapView } from "./map/view";
import { PlaceView } from "./places/card";
import { lastChange } from "./places/changes";
import { PlanView } from "./plan/view";
import { Review } from "./review/review";
import { offerNoOthers, offerOthers, showChoice } from "./robots/choice";
import { openHijack } from "./robots/hijack";
import { HealthView } from "./status/health";
import { EventLog } from "./status/log";
import { by, show } from "./ui/dom";
import { attempt } from "./ui/toast";

const video = new VideoView();
const drive = new DriveControl(video, document.body.dataset.role !== "watch");
const library = new Library({
  onChange: () => health.draw(),
  onReplay: (navigation) => review.replay(navigation),
  onCompare: (id) => review.compare(id),
});
const health = new HealthView(library);
const log = new EventLog();
const places = new PlaceView();
const calibrate = new CalibrateDialog(video.canvas, drive.pad, (say) => drive.emergencyStop("STOP", say));
video.onPicture = () => calibrate.showPicture();
const plan = new PlanView((place) => places.open(place));
const map = makeMap();

/** Without WebGL everything but the 3D view works. */
function makeMap(): MapView | null {
  try {
    return new MapView(video.canvas, plan, {
      onPlace: (place) => places.open(place),
      onPlaces: (all) => places.setPlaces(all),
    });
  } catch {
    by("scene-empty").textContent = "This browser shows no 3D graphics (WebGL is off).";
    return null;
  }
}

const review = new Review(map);

function take(message: EventMessage): void {
  switch (message.type) {
    case "robot":
      drive.show(message.robot);
      drive.showDriver(message.robot.driver);
      health.showRobot(message.robot);
      library.setConnected(message.robot.connected);
      show(by("calibrate"), Boolean(message.robot.capabilities?.camera));
      show(by("hijack"), Boolean(message.robot.connected && message.robot.capabilities?.hijack));
      break;
    case "driver":
      drive.showDriver(message.driver);
      break;
    case "pose":
      map?.showSlam(message.slam);
      health.showSlam(message.slam);
      library.showSlam(message.slam);
      break;
    case "landmarks":
      if (message.total) map?.suggestLive();
      if (map) attempt(() => map.updateLive(message.source, message.total));
      break;
    case "navigation":
      if (message.navigation) library.update(message.navigation);
      else attempt(() => library.reloadNavigations());
      break;
    case "map":
      attempt(() => plan.showMap(message.has_plan ? message.active : null));
      if (map) attempt(() => map.showMap(message.active, message.revision));
      else plan.setVisible(message.has_plan);
      attempt(() => lastChange.showMap(message.active));
      attempt(() => library.reloadMaps());
      break;
    case "job":
      library.updateJob(message.job);
      calibrate.showJob(message.job);
      break;
    case "place":
      places.show(message.place, message.visit);
      plan.showPlace(message.place);
      map?.showPlace(message.place);
      break;
    case "calibration":
      calibrate.show(message.session);
      break;
    case "bin":
      attempt(() => library.reloadBin());
      break;
    case "log":
      log.add([message.line]);
      break;
  }
}

new LastingSocket("/ws/events", {
  onMessage: (data) => take(JSON.parse(data as string) as EventMessage),
  onState: (open) => {
    health.setStation(open);
    if (open) {
      offerNoOthers();
      attempt(load);
    } else checkRobot().catch(() => undefined); // the station is away: the page says so already
  },
  isSteady: true,
});

/**
 * What the event stream does not tell from its beginning: lists and the past. After opening the page, and after the
 * station was away. States (robot, pose, active map, place) come by events alone, so that nothing can undo them.
 */
async function load(): Promise<void> {
  log.clear();
  await Promise.all([
    library.reload(),
    places.reload(),
    call<LogModel[]>("GET", "/log").then((lines) => log.add(lines)),
    call<RobotEntry[]>("GET", "/robots").then((robots) => showChoice(by("robots", HTMLSelectElement), robots)),
  ]);
}

/** A station that was started anew may know the robot of this address no more: then its sockets never open again. */
async function checkRobot(): Promise<void> {
  const robots = await call<RobotEntry[]>("GET", "/robots");
  const missing = findMissing(robots);
  if (missing !== null) offerOthers(missing, robots);
}

by("hijack").addEventListener("click", openHijack);
