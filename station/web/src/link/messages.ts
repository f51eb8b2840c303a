// Made by `python -m station.api.page_types` from station/api/schema and station/api/messages.py. Do not edit.

/** By the rests on several sides. Scale and misalignment are told; the bias drifts, and is estimated on the way. */
export interface AccelerometerResult {
  scale: number[];
  /** rad; null: too few sides */
  misalignment: number[] | null;
  /** m/s² */
  bias: number[];
}

/** Done. */
export interface Accepted {
  ok: true;
}

/** How far the next thing ahead is, as the robot's depth sensor measures it. Nothing stops by it. */
export interface AheadModel {
  /** from the sensor; null: it measured nothing ahead, which is not to say that nothing is there */
  distance_m: number | null;
  /** since it came to the station; null: nothing for 1.5 s */
  age_s: number | null;
}

/** What the motors were told. */
export interface AppliedModel {
  linear: number;
  angular: number;
}

export interface BatteryModel {
  voltage_v: number | null;
  fraction: number | null;
}

/** Something was deleted or restored: fetch GET /bin. */
export interface BinMessage {
  type: "bin";
}

/** Something deleted that can still be restored. */
export interface BinModel {
  kind: "navigation" | "map";
  id: string;
  name: string;
  deleted_unix_s: number;
  /** when it is deleted for good, where the station runs until then */
  gone_unix_s: number;
}

/** What one picture shows of the board, and what to do next. */
export interface BoardSeenModel {
  t_robot_ns: number;
  corners_px: number[][];
  instruction: string;
  /** this view counts */
  is_taken: boolean;
  /** that count */
  num_views: number;
  /** how full each of the 3x3 cells of the picture is, 0..1, by rows; only for kind camera */
  cells: number[];
  /** how many of the wanted views of each pose there are, 0..1; for camera-imu tilt, turn, roll, distance and time: how much of each wanted motion; for wheels forth, back, left, right; for imu time at rest; for check roll, tilt, turn, time */
  poses: Record<string, number>;
  meter: MeterModel[];
  /** there may be enough to estimate from */
  may_finish: boolean;
  is_enough: boolean;
}

/** What a drive says of the camera's calibration, with one standard deviation each. */
export interface CalibrationFitModel {
  verdict: "fits" | "does not fit" | "not known yet";
  /** for a person */
  sentence: string;
  /** the focal length that the data want, over the told one */
  focal_scale: number;
  focal_sigma: number;
  /** the camera is turned by that about its axes right, down, forward */
  mounting_deg: number[];
  mounting_sigma_deg: number[];
  /** to be added to the calibration's */
  time_shift_s: number;
  time_shift_sigma_s: number;
}

/** The guided calibration, a few times a second while a board is looked at; null: there is none. */
export interface CalibrationMessage {
  type: "calibration";
  session: CalibrationSessionModel | null;
}

/** What the robot tells of its sensors now, where that comes from, and whether it fits what was driven. */
export interface CalibrationModel {
  camera: CameraModel | null;
  imu: ImuModel | null;
  /** 1 and 1: not measured */
  wheels: WheelsModel;
  rig: "wheels" | "hand-held" | "unknown";
  /** where the robot has it from */
  source: string;
  /** the one before it is kept: POST /calibration/undo */
  can_undo: boolean;
  /** why the robot takes no other one, in a sentence; empty: it does */
  fixed: string;
  /** of the last navigation with this calibration; null: none yet */
  fit: CalibrationFitModel | null;
}

/** In the fields and units that a calibration's result has. */
export interface CalibrationOrder {
  camera: CameraOrder | null;
  imu: ImuOrder | null;
  wheels: WheelsOrder | null;
  /** the result of this guided calibration */
  session: string | null;
}

/** A guided calibration, as far as it is. */
export interface CalibrationSessionModel {
  id: string;
  kind: "camera" | "camera-imu" | "wheels" | "imu" | "check";
  state: "looking" | "estimating" | "done" | "failed";
  /** why it failed, in a sentence */
  message: string;
  /** of the robot's pictures: width, height */
  resolution: number[];
  /** the newest picture that was looked at */
  seen: BoardSeenModel | null;
  /** that estimates; empty: not yet */
  job: string;
  /** of kind camera */
  result: CameraResult | null;
  /** the result of kind camera-imu */
  mounting: MountingResult | null;
  /** the result of kind check */
  check: CheckResult | null;
  /** the result of kind wheels */
  wheels: WheelsResult | null;
  /** the result of kind imu */
  imu: ImuResult | null;
  /** the robot tells this result now */
  is_used: boolean;
  /** the path of what was recorded */
  recording: string;
}

/** The centre of the first pixel is (0, 0). */
export interface CameraModel {
  model: "radtan" | "equidistant";
  /** width, height */
  resolution: number[];
  /** fx, fy, cx, cy in px */
  intrinsics: number[];
  /** radtan: k1 k2 p1 p2; equidistant: k1 k2 k3 k4 */
  distortion: number[];
  /** 4x4, camera to body (= IMU) coordinates, m */
  T_body_cam: number[][];
  /** t_imu = t_cam + time_shift_s */
  time_shift_s: number;
  /** row v is exposed line_delay_s * v after row 0; 0: all at once */
  line_delay_s: number;
  /** false: another robot's numbers, for want of its own */
  is_measured: boolean;
  /** false: where it sits and when it sees are the reference robot's, for want of its own */
  is_mounting_measured: boolean;
}

/** What is left out stays as the robot tells it now. */
export interface CameraOrder {
  model: "radtan" | "equidistant" | null;
  resolution: number[] | null;
  /** fx, fy, cx, cy in px */
  intrinsics: number[] | null;
  distortion: number[] | null;
  T_body_cam: number[][] | null;
  time_shift_s: number | null;
  line_delay_s: number | null;
}

/** What the estimate came to. */
export interface CameraResult {
  /** null, as the numbers: there was too little to estimate anything */
  model: "radtan" | "equidistant" | null;
  resolution: number[];
  intrinsics: number[] | null;
  distortion: number[] | null;
  rms_px: number | null;
  sigma: Record<string, number>;
  images_used: number;
  images_rejected: RejectedImage[];
  coverage: number;
  line_delay_s: number | null;
  accepted: boolean;
  reasons: string[];
}

export interface CapabilitiesModel {
  camera: boolean;
  imu: boolean;
  drive: boolean;
  pan_tilt: boolean;
  battery: boolean;
  hijack: boolean;
  max_linear_m_s: number;
  max_angular_rad_s: number;
}

/** What a recording without a board says of the calibration; the numbers are those told, or repaired. */
export interface CheckResult {
  T_body_cam: number[][] | null;
  time_shift_s: number | null;
  line_delay_s: number | null;
  /** m/s² in the target's axes */
  gravity: number[] | null;
  sigma: MountingSigma | null;
  rms_px: number | null;
  /** rad/s */
  rms_gyro: number | null;
  /** m/s² */
  rms_accel: number | null;
  model: "radtan" | "equidistant";
  resolution: number[];
  /** of the lens, a little refined */
  intrinsics: number[] | null;
  distortion: number[] | null;
  accepted: boolean;
  reasons: string[];
  /** of each quantity whether it fits, or why this motion does not show it */
  notes: string[];
  /** null: this motion does not show all of it */
  fits: boolean | null;
  /** the quantities that the robot should tell otherwise */
  repairs: string[];
}

export interface ClockModel {
  /** t_station - t_robot */
  offset_s: number | null;
  /** by how much the offset may be wrong at most */
  bound_ms: number | null;
  drift_ppm: number | null;
  rtt_ms: number | null;
}

/** Two navigations compared; the report has the pictures. */
export interface ComparisonModel {
  id: string;
  name: string;
  first: string;
  second: string;
  made_unix_s: number;
  /** of the first navigation */
  places: number;
  /** of the second one */
  locations: number;
  matches: number;
  /** the registration */
  accepted: boolean;
  /** why it was refused */
  reasons: string[];
  /** row-major 4x4, may carry a scale */
  T_first_second: number[] | null;
  report: string;
}

/** Which navigations to compare: places are made of the first one and looked for in the second. */
export interface ComparisonOrder {
  first: string;
  second: string;
}

/** Which place the robot is at, and in which room. `place` is null unless the state is "known"; the room may be */
export interface CurrentPlace {
  state: "known" | "unknown" | "lost";
  place: PlaceName | null;
  /** id of the room that `place` is in */
  place_room: string | null;
  /** that is another room than `room`: the nearest place is behind a door or a thin wall. In a doorway the robot is in both */
  place_elsewhere: boolean;
  /** that `place` is the nearest one or within 10 % of that; of the likeliest one while none is known */
  probability: number;
  /** robot to the place's centroid; null without a metric map */
  distance_m: number | null;
  /** x, y, z of the robot in `map` */
  position_map: number[] | null;
  /** x, y, z of where the robot's front points, of length 1; null without a position */
  forward_map: number[] | null;
  /** 1 sigma per axis of the position; null without one, or without a metric map */
  sigma_position_m: number | null;
  /** since the picture the answer is about was taken */
  age_s: number | null;
  /** id of the active map that place, position and evidence are of; while there are none, the first */
  map: string | null;
  alternatives: PlaceProbability[];
  /** null while none is probable enough, or the map has no rooms */
  room: RoomProbability | null;
  /** what else it may be, the likeliest first */
  room_alternatives: RoomProbability[];
  /** while `room` is null, the two it is surely one of, such as rooms that look alike; else empty */
  one_of_two: RoomProbability[];
  /** id of the door of GET /floorplan in which the robot is: both of its rooms are right then */
  doorway: string | null;
  evidence: Evidence;
  /** 0..1 while the map is prepared for answers; else null */
  preparing: number | null;
  /** the calibration does not fit: no place or room is told, and position, alternatives and their probabilities are what would follow if it did */
  withheld: boolean;
  /** in a sentence */
  reason: string;
  /** sensor time the answer is about, robot clock */
  t_robot_ns: number | null;
  /** T_map_cam of the newest picture, row-major 4x4; null when it was not recognised in `map` */
  pose_map: number[] | null;
}

/** A passage between two rooms. */
export interface DoorModel {
  id: string;
  /** the two it leads to; null: nobody went through */
  rooms: (string | null)[];
  /** where its jambs are on the plan */
  ends: number[][];
  /** map units */
  width: number;
  /** by a person */
  drawn: boolean;
}

/** The newest command went to the robot. */
export interface DriveAccepted {
  type: "accepted";
  seq: number;
}

export interface DriveCommand {
  type: "drive";
  seq: number;
  linear: number;
  angular: number;
  ttl_ms: number;
  /** t_ms of the newest `time` heard before */
  heard_ms: number | null;
}

/** Hold this velocity, then stop. */
export interface DriveOrder {
  /** m/s, forward */
  linear: number;
  /** rad/s, left */
  angular: number;
  /** stop after this, unless told again */
  ttl_ms: number;
}

/** The command was refused, and why. */
export interface DriveRefused {
  type: "refused";
  /** the kind of problem, as in problem documents */
  problem: string;
  text: string;
}

/** Who drives; sent at the start and at every change. */
export interface DriveReply {
  type: "driver";
  driver: string | null;
  you_drive: boolean;
}

export interface DriverMessage {
  type: "driver";
  driver: string | null;
}

export interface DriverModel {
  /** who drives through this station */
  driver: string | null;
  /** that is you, and the robot has not said that another station drives it */
  you_drive: boolean;
  /** so long the driver keeps the wheel without another word */
  keeps_s: number;
}

export interface EdgeModel {
  a: string;
  b: string;
  /** a to b in the ground plane, from +x towards +y */
  bearing_rad: number;
  /** between centroids, map units */
  distance: number;
  kind: "seen together" | "driven between" | "nearest";
}

/** Why: the running picture and the map's picture that shows the same landmarks. */
export interface Evidence {
  query_image: string | null;
  map_image: string | null;
  /** landmarks of the map found where they belong */
  inliers: number;
  /** since the picture that was recognised */
  age_s: number | null;
}

/** Achieved over commanded, from several moves. */
export interface FactorResult {
  value: number;
  sigma: number;
  /** of a single move, relative */
  scatter: number;
  moves: number;
}

/** One figure of the three axes together. */
export interface FigureResult {
  /** null: only an upper limit is known */
  value: number | null;
  /** 95 % */
  interval: number[];
  unit: string;
}

/** The plan of the active map's floor, in axes of its own: x to the right, y up. */
export interface FloorPlanModel {
  map: string;
  /** lengths are metres; false: map units of unknown scale */
  metric: boolean;
  /** map units per metre; a guess unless the map is metric */
  unit: number;
  /** turns positions of the map to the plan's x, y and up */
  R_ground_map: number[][];
  /** where the smallest x and y of rooms and walls are */
  low: number[];
  high: number[];
  rooms: PlanRoom[];
  doors: DoorModel[];
  walls: number[][][];
  /** those that are not hidden */
  places: PlanPlace[];
  /** of the drives that it was made from */
  path: number[][];
}

/** The topological map. */
export interface GraphModel {
  map: string;
  /** distances are metres; false: of unknown scale */
  metric: boolean;
  nodes: PlaceModel[];
  edges: EdgeModel[];
}

export interface HealthModel {
  status: "ok";
  version: string;
  uptime_s: number;
  robot_connected: boolean;
  /** in words */
  localisation: string;
}

/** Where to put it down; nothing at all: wherever the robot likes. */
export interface HijackOrder {
  /** m, the simulated world's frame */
  x: number | null;
  y: number | null;
  /** rad */
  yaw: number;
}

/** Continuous-time noise, in SI units as kalibr has it. */
export interface ImuModel {
  gyro_noise_density: number;
  gyro_random_walk: number;
  accel_noise_density: number;
  accel_random_walk: number;
  rate_hz: number;
  /** force = T (scale * reading), along x, y, z; null: not measured */
  accel_scale: number[] | null;
  /** rad, of T: y to x, z to x, z to y */
  accel_misalignment: number[] | null;
}

/** What is left out stays as the robot tells it now. */
export interface ImuOrder {
  gyro_noise_density: number | null;
  gyro_random_walk: number | null;
  accel_noise_density: number | null;
  accel_random_walk: number | null;
  accel_scale: number[] | null;
  accel_misalignment: number[] | null;
}

/** What a recording at rest came to; in `result.json` is all of it, axis by axis. */
export interface ImuResult {
  gyro_noise_density: FigureResult | null;
  gyro_random_walk: FigureResult | null;
  accel_noise_density: FigureResult | null;
  accel_random_walk: FigureResult | null;
  /** what the estimation is told */
  used: UsedNoise | null;
  /** null: it did not lie on enough sides */
  accelerometer: AccelerometerResult | null;
  duration_s: number;
  accepted: boolean;
  reasons: string[];
  /** what it cannot tell, or what was cut out of it */
  notes: string[];
}

export interface JobMessage {
  type: "job";
  job: JobModel;
}

/** Work in the background. */
export interface JobModel {
  id: string;
  kind: string;
  title: string;
  state: "running" | "done" | "failed" | "cancelled";
  /** 0..1 */
  progress: number;
  message: string;
  result: Record<string, string | number | null> | null;
}

/** There are new landmarks: fetch GET /landmarks?since=. */
export interface LandmarksMessage {
  type: "landmarks";
  navigation: string | null;
  /** the cloud: X-Source of GET /landmarks */
  source: string | null;
  total: number;
}

export interface LogMessage {
  type: "log";
  line: LogModel;
}

/** Something a person may want to know. */
export interface LogModel {
  number: number;
  unix_s: number;
  level: "info" | "warning" | "error";
  topic: string;
  text: string;
}

export interface LossesModel {
  frames_skipped: number;
  imu_gaps: number;
  imu_lost: number;
  imu_lost_in_sensor: number;
}

/** Where robots are looked for. */
export interface MapChoice {
  /** null: no map */
  id: string | null;
  /** further maps, of other rooms; their order means nothing */
  also: string[];
}

/** The list of maps, the active one or a name in it changed. */
export interface MapMessage {
  type: "map";
  active: string | null;
  /** another one: the active map is another, or its places or rooms are */
  revision: number;
  /** GET /floorplan has something to show */
  has_plan: boolean;
}

export interface MapModel {
  id: string;
  name: string;
  places: number;
  /** robots are looked for in it */
  active: boolean;
  /** it is the active map whose places GET /places and GET /graph show */
  first: boolean;
  /** a sentence, where the map is active and the calibration of its navigation does not fit, or seems not to and is not known yet */
  misfit: string;
  /** a sentence, where the map cannot be read */
  damaged: string;
}

/** What to build a map from. */
export interface MapOrder {
  navigations: string[];
  name: string;
  mode: "default" | "thesis" | null;
  /** at most six in each room, or every cluster of landmarks (in thesis mode always) */
  places: "rooms" | "fine";
  /** use the map as soon as it is built */
  activate: boolean;
}

/** One quantity, and how well the views so far tell it. */
export interface MeterModel {
  name: string;
  value: number;
  /** one standard deviation */
  sigma: number;
  /** the sigma that is good enough */
  wanted: number;
  unit: string;
}

/** What the estimate of camera and IMU came to; numbers are null where there was too little to estimate anything. */
export interface MountingResult {
  T_body_cam: number[][] | null;
  time_shift_s: number | null;
  line_delay_s: number | null;
  /** m/s² in the target's axes */
  gravity: number[] | null;
  sigma: MountingSigma | null;
  rms_px: number | null;
  /** rad/s */
  rms_gyro: number | null;
  /** m/s² */
  rms_accel: number | null;
  model: "radtan" | "equidistant";
  resolution: number[];
  /** of the lens, a little refined */
  intrinsics: number[] | null;
  distortion: number[] | null;
  accepted: boolean;
  reasons: string[];
  /** what was not used of the recording */
  notes: string[];
}

export interface MountingSigma {
  /** about the camera's axes */
  rotation_deg: number[];
  translation_m: number[];
  time_shift_s: number;
  line_delay_s: number;
  gravity: number[];
}

/** A name that something seen speaks for; PATCH /rooms/{id} uses it, nobody else does. */
export interface NameSuggestionModel {
  name: string;
  source: "sticker" | "door plate" | "model" | "other map";
  /** 0..1 */
  confidence: number;
  reason: string;
  /** the picture that shows it */
  image: string | null;
  /** where in that picture */
  corners_px: number[][] | null;
}

/** A navigation changed; null: one was deleted. */
export interface NavigationMessage {
  type: "navigation";
  navigation: NavigationModel | null;
}

/** One recorded navigation and what SLAM made of it. */
export interface NavigationModel {
  id: string;
  name: string;
  state: "recording" | "finishing" | "ready" | "failed";
  message: string;
  /** its name in GET /robots when it drove; empty: an old navigation */
  robot: string;
  started_unix_s: number;
  duration_s: number;
  backend: string;
  frames: number;
  /** by live SLAM; the recording has them */
  frames_skipped: number;
  imu_samples: number;
  imu_lost: number;
  /** pictures or samples that SLAM refused; the message quotes it */
  slam_failures: number;
  landmarks: number;
  scale: "metric" | "arbitrary" | "";
  /** where to download the MCAP file */
  recording: string | null;
}

export interface NavigationStart {
  name: string;
}

/** What a driver needs to know of the network between station and robot. */
export interface NetworkModel {
  grade: "none" | "silent" | "good" | "slow" | "bad";
  /** for a person */
  sentence: string;
  /** of nine in ten heartbeats at most */
  round_trip_ms: number | null;
  /** of nine in ten pictures at most, on arrival at the station */
  picture_age_ms: number | null;
  /** what is late is so by the station's computer, not by the network */
  computer_busy: boolean;
}

/** What it shall be called. */
export interface NewName {
  name: string;
}

/** What a room shall be called. */
export interface NewRoomName {
  /** null: as nobody had named it, Room 2 for example */
  name: string | null;
}

export interface PanTiltCommand {
  type: "pan_tilt";
  pan: number;
  tilt: number;
}

export interface PanTiltOrder {
  /** rad, left */
  pan: number;
  /** rad, up */
  tilt: number;
}

/** What is to be otherwise; what is left out or null stays, and one thing must be said. */
export interface PlaceChange {
  name: string | null;
  hidden: boolean | null;
}

/** Which places are one; it keeps id and name of the first. */
export interface PlaceMerge {
  places: string[];
}

export interface PlaceMessage {
  type: "place";
  place: CurrentPlace;
  visit: VisitModel | null;
}

/** A place of the active map. */
export interface PlaceModel {
  id: string;
  name: string;
  centroid_map: number[];
  /** RMS distance of its landmarks from the centroid, map units */
  radius: number;
  landmarks: number;
  /** keyframes that saw it */
  images: number;
  /** 0..1, how clearly it stands out, and of how many landmarks */
  quality: number;
  representative_image: string | null;
  mean_image: string | null;
  /** how much the brightness of its pictures differs */
  deviation_image: string | null;
  /** its number in GET /maps/{id}/landmarks; neighbours differ in the remainder by 12 */
  colour: number;
  /** by a person: never the current place, and not in the graph */
  hidden: boolean;
  /** a person gave it its name */
  named: boolean;
  /** id of the room it is in */
  room: string | null;
}

export interface PlaceName {
  id: string;
  name: string;
}

export interface PlaceProbability {
  id: string;
  name: string;
  /** that it is the nearest one or within 10 % of that: several may sum to more than 1 */
  probability: number;
  /** id of the active map that it is a place of */
  map: string;
}

/** What a person made of places or rooms: renamed, hidden, merged, doors drawn and erased. */
export interface PlacesChangeModel {
  /** id of the map that was changed */
  map: string;
  /** of that map, that the change led to */
  version: number;
  why: string;
  unix_s: number;
}

/** A place as it is drawn. */
export interface PlanPlace {
  id: string;
  name: string;
  at: number[];
  room: string | null;
  colour: number;
  representative_image: string | null;
}

/** A room as it is drawn. */
export interface PlanRoom {
  id: string;
  name: string;
  named: boolean;
  middle: number[];
  /** closed lines: what is inside an odd number of them is the room */
  outline: number[][][];
}

export interface PoseMessage {
  type: "pose";
  slam: SlamModel;
}

/** What went wrong (RFC 9457). */
export interface Problem {
  type: string;
  title: string;
  status: number;
  detail: string;
  instance: string;
}

export interface RatesModel {
  frames_hz: number;
  imu_hz: number;
  bytes_per_s: number;
}

export interface RejectedImage {
  image: string;
  reason: string;
}

export interface ReleaseCommand {
  type: "release";
}

/** Where the camera was during a recorded navigation; the pictures come by /ws/replay. */
export interface ReplayModel {
  navigation: string;
  /** robot clock, of the first pose */
  start_ns: number;
  /** since start_ns, increasing; at most `limit` poses */
  t_s: number[];
  /** row-major 4x4 each */
  T_world_cam: number[][];
}

/** How to run SLAM over a recording again. */
export interface ReprocessOrder {
  /** null: the station's own */
  backend: "sfm" | "ukf" | "mono" | "smoothing" | null;
}

/** One of the station's robots, and where it is. */
export interface RobotEntry {
  /** in this station */
  name: string;
  /** put before a call to ask for this robot */
  path: string;
  /** id of the one that is being recorded */
  navigation: string | null;
  state: "known" | "unknown" | "lost";
  place: PlaceName | null;
  robot: RobotModel;
}

export interface RobotMessage {
  type: "robot";
  robot: RobotModel;
}

/** Link, battery, rates, losses, clock, who drives. */
export interface RobotModel {
  connected: boolean;
  /** why not connected, in a sentence */
  reason: string;
  host: string;
  port: number;
  robot_id: string | null;
  name: string | null;
  capabilities: CapabilitiesModel | null;
  calibrated: boolean;
  /** of the last navigation since the robot connected that knows whether it fits, or of the last; null: none yet */
  calibration_fit: CalibrationFitModel | null;
  connections: number;
  network: NetworkModel;
  rates: RatesModel;
  losses: LossesModel;
  clock: ClockModel;
  battery: BatteryModel | null;
  temperatures_c: Record<string, number>;
  /** of one core, robot-server */
  cpu_percent: number | null;
  /** who drives through this station */
  driver: string | null;
  /** the station that drives, as the robot says */
  robot_driver: string | null;
  applied: AppliedModel | null;
  /** null: the robot has no depth sensor, or none is connected */
  ahead: AheadModel | null;
  /** why the camera head must look straight ahead; empty: it may turn */
  head_must_rest: string;
  /** what is wrong in the robot, or with the station's file of paired robots */
  faults: string[];
}

/** Which rooms are one; it keeps id and name of the first. */
export interface RoomMerge {
  rooms: string[];
}

/** A room of the active map. */
export interface RoomModel {
  id: string;
  name: string;
  /** a person gave it its name */
  named: boolean;
  /** null without a metric map */
  area_m2: number | null;
  /** x, y on the plan: a free spot far from its walls */
  middle: number[];
  /** ids of the doors that lead out of it */
  doors: string[];
  /** its places that are not hidden */
  places: PlaceName[];
  /** names that something seen speaks for, the surest first */
  suggestions: NameSuggestionModel[];
}

export interface RoomName {
  id: string;
  name: string;
}

export interface RoomProbability {
  id: string;
  name: string;
  /** that the robot is in it or in a doorway of it: two may sum to more than 1 */
  probability: number;
}

/** A line right across a room, from wall to wall, as on the plan: a door. */
export interface RoomSplit {
  line: number[][];
}

/** The shortest way along the graph's edges. */
export interface RouteModel {
  map: string;
  /** distances are metres; false: of unknown scale */
  metric: boolean;
  /** from start to goal */
  places: PlaceName[];
  /** from each place to the next one */
  legs: EdgeModel[];
  /** of all legs, map units */
  length: number;
}

/** Who asks. */
export interface SessionModel {
  /** false: everybody who reaches this station is admin */
  controlled: boolean;
  name: string;
  role: "watch" | "drive" | "admin";
}

/** The running SLAM, or the last one. */
export interface SlamModel {
  navigation: string | null;
  state: "none" | "initialising" | "tracking" | "lost" | "finishing" | "finished";
  message: string;
  landmarks: number;
  frames: number;
  t_robot_ns: number | null;
  /** row-major 4x4; null while there is no pose */
  T_world_body: number[] | null;
  /** the same for the camera */
  T_world_cam: number[] | null;
  segment: number;
}

/** Motors off, and why: the log shows it. */
export interface StopCommand {
  type: "stop";
  reason: string;
}

/** It was sent. */
export interface StopModel {
  ok: true;
  /** the robot said that it has stopped; false: sent, not confirmed yet */
  confirmed: boolean;
}

export interface TakeOverCommand {
  type: "take_over";
}

/** The station's clock, twenty times a second. A drive command that repeats it shows by it that it is not old. */
export interface TimeReply {
  type: "time";
  t_ms: number;
}

/** Poses so far, oldest first; thinned to `limit` poses. */
export interface TrajectoryModel {
  navigation: string | null;
  /** the cloud it belongs to: X-Source of GET /landmarks */
  source: string | null;
  total: number;
  t_robot_ns: number[];
  /** body positions, (N, 3) */
  p_world: number[][];
}

/** What to take back. */
export interface UndoOrder {
  /** only if this is the newest change; null: whatever it is */
  version: number | null;
  /** only if this map is in use; null: whichever is */
  map: string | null;
}

export interface UsedNoise {
  gyro_noise_density: number;
  gyro_random_walk: number;
  accel_noise_density: number;
  accel_random_walk: number;
  rate_hz: number;
  accel_scale: number[] | null;
  accel_misalignment: number[] | null;
}

/** A stretch of time with one answer. */
export interface VisitModel {
  state: "known" | "unknown" | "lost";
  place: PlaceName | null;
  /** id of the room that `place` is in */
  place_room: string | null;
  /** that is another room than `room`: the nearest place is behind a door or a thin wall. In a doorway the robot is in both */
  place_elsewhere: boolean;
  room: RoomName | null;
  start_unix_s: number;
  end_unix_s: number;
}

/** What the motors make of a command by themselves; the robot asks them for that much more. */
export interface WheelsModel {
  /** m/s over ground for each commanded one */
  speed: number;
  /** rad/s likewise */
  turn: number;
}

/** What is left out stays as the robot tells it now; 1 where it tells nothing. */
export interface WheelsOrder {
  speed: number | null;
  turn: number | null;
}

/** What the wheels make of a command, as the robot drove when it began. */
export interface WheelsResult {
  speed: FactorResult | null;
  turn: FactorResult | null;
  /** of two equal lags one after the other, motor and gear */
  lag_s: number | null;
  lag_sigma_s: number | null;
  accepted: boolean;
  reasons: string[];
}

export type EventMessage =
  | RobotMessage
  | DriverMessage
  | PoseMessage
  | LandmarksMessage
  | NavigationMessage
  | MapMessage
  | JobMessage
  | PlaceMessage
  | BinMessage
  | CalibrationMessage
  | LogMessage;

export type DriveRequest =
  | DriveCommand
  | StopCommand
  | PanTiltCommand
  | TakeOverCommand
  | ReleaseCommand;

export type DriveAnswer =
  | DriveAccepted
  | DriveRefused
  | DriveReply
  | TimeReply;
