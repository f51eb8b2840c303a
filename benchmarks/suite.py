"""Every benchmark that `make bench` and `make results` run: its arguments, and where its figures belong."""

from __future__ import annotations

from dataclasses import dataclass

DATA = "../shared/data"  # recorded data, beside the repository
LINK, SLAM, PLACES = "Robot, link and stop", "Simulator and SLAM", "Places and registration"
CURRENT, PAGE, KEPT = "Current place", "Page and API", "Maps and recordings"


@dataclass(frozen=True, slots=True)
class Benchmark:
    """One run of a module, and where its figures belong."""

    name: str  # of its result file
    subject: str  # heading in docs/results.md
    module: str
    full: str  # arguments as in a shell
    quick: str | None  # None: it cannot be made short
    has_own_target: bool = False  # `make bench` leaves it to that
    data: str = ""  # recorded data that must be there


SUITE = (
    Benchmark("clock", LINK, "bench_clock", "--runs 1000", "--runs 20"),
    Benchmark("link", LINK, "bench_link", "--minutes 10 --stall-minutes 2", "--minutes 0.1 --stall-minutes 0.2"),
    Benchmark("disconnects", LINK, "bench_disconnects", "--disconnects 10000", "--disconnects 20 --links 2 --pages 1"),
    Benchmark("access", LINK, "bench_access", "--frames 600", "--frames 20"),
    Benchmark("strangers", LINK, "bench_strangers", "--seconds 30", "--seconds 1"),
    Benchmark("robot_cpu", LINK, "bench_robot_cpu", "--seconds 20", "--seconds 2"),
    Benchmark("robot_wheels", LINK, "check_robot_wheels", "", None),
    Benchmark("fuzz", LINK, "bench_fuzz", "--inputs 1000000", "--inputs 2000"),
    Benchmark("stop", LINK, "bench_stop", "", "--scale 0.01", has_own_target=True),
    Benchmark("network", LINK, "bench_network", "--seconds 240", "--profiles bad --seconds 5", has_own_target=True),
    Benchmark("network_cuts", LINK, "bench_network", "--cuts-alone --seconds 240", None),
    Benchmark("network_demo_busy", LINK, "bench_network_demo", "--profiles 'busy 2.4 GHz'", None),
    Benchmark("network_demo_two_walls", LINK, "bench_network_demo", "--profiles 'two walls'", None),
    Benchmark("network_demo_others", LINK, "bench_network_demo", "--profiles 'good Wi-Fi' roaming", None),
    Benchmark("fleet", LINK, "bench_fleet", "--minutes 10", "--minutes 0.5 --robots 2"),
    Benchmark(
        "memory", LINK, "bench_memory",
        "--minutes 180 --warm-up 10 --fps 5 --together --devices simulated recorded", "--minutes 0.5 --warm-up 0.2",
    ),
    # By themselves: all six cases at once take two cores whole, and starve each other.
    Benchmark(
        "memory_emulated", LINK, "bench_memory",
        "--minutes 180 --warm-up 10 --fps 5 --together --devices emulated", None,
    ),
    Benchmark(
        "memory_emulated_recording", LINK, "bench_memory",
        "--minutes 180 --warm-up 10 --fps 3 --devices emulated --doing recording", None,
    ),
    Benchmark("renderer", SLAM, "bench_renderer", "--frames 200", "--frames 5"),
    Benchmark("simulated_views", SLAM, "bench_simulated_views", "--seeds 10", "--seeds 1 --pairs 2"),
    Benchmark("plain_views", SLAM, "bench_simulated_views", "--world plain --seeds 10", None),
    Benchmark("sfm", SLAM, "bench_sfm", "--seeds 0-3", "--seeds 1 --max-duration 12"),
    Benchmark(
        "slam_flight", SLAM, "bench_slam", f"datasets {DATA}/euroc_v1_01_flight --start own --start given", None,
        data=f"{DATA}/euroc_v1_01_flight",
    ),
    Benchmark("slam_drive", SLAM, "bench_slam", "datasets --flats 1", "datasets --flats 1 --max-duration 12"),
    Benchmark("slam_wheels", SLAM, "bench_slam", "wheels --flats 1", None),
    Benchmark("slam_consistency", SLAM, "bench_slam", "consistency --runs 50", "consistency --runs 1 --duration 3"),
    Benchmark(
        "slam_v102_own", SLAM, "slam_studies", "v102 --start own --discard", None, data=f"{DATA}/euroc_v1_02_imu"
    ),
    Benchmark(
        "slam_v102_given", SLAM, "slam_studies", "v102 --start given --discard", None, data=f"{DATA}/euroc_v1_02_imu"
    ),
    Benchmark("slam_flats", SLAM, "slam_studies", "flats --discard", None),
    Benchmark(
        "smoothing", SLAM, "bench_smoothing",
        f"{DATA}/euroc_v1_01_flight {DATA}/euroc_v1_01_static --flats 0-2", None, data=f"{DATA}/euroc_v1_01_flight",
    ),
    Benchmark(
        "smoothing_v102", SLAM, "bench_smoothing", "--v102 0-19 --backend smoothing", None,
        data=f"{DATA}/euroc_v1_02_imu",
    ),
    Benchmark("smoothing_flats", SLAM, "bench_smoothing", "--flats 0-19 --backend smoothing", None),
    Benchmark("smoothing_plain", SLAM, "bench_smoothing", "--plain 0-19 --backend smoothing", None),
    Benchmark(
        "slam_speed", SLAM, "slam_studies", "speed", None, has_own_target=True, data=f"{DATA}/euroc_v1_02_imu"
    ),
    Benchmark("calibrate_wheels", SLAM, "bench_calibrate_wheels", "--seeds 0-19", "--seeds 0"),
    Benchmark("calibrate_check", SLAM, "bench_calibrate_check", "--seeds 210-217", "--seeds 200"),
    Benchmark(
        "mono", SLAM, "bench_mono",
        f"--points 0-19 --rendered 0-9 --recorded {DATA}/euroc_v1_01_flight {DATA}/redkitchen:0-198",
        "--points 0 --rendered 0 --seconds 2", data=f"{DATA}/redkitchen",
    ),
    Benchmark("calibrate_camera_imu", SLAM, "bench_calibrate_camera_imu", "--seeds 0-19", "--seeds 0 --no-poor"),
    Benchmark("calibration_fit", SLAM, "bench_calibration_fit", "--flats 1-8", "--flats 1 --told focal=1"),
    Benchmark(
        "calibrate_camera", SLAM, "bench_calibrate_camera", f"--data {DATA} --halves 20", f"--data {DATA} --halves 1",
        data=f"{DATA}/aprilgrid_euroc",
    ),
    Benchmark("calibrate_camera_sessions", SLAM, "bench_calibrate_camera_sessions", "--seeds 0-19", "--seeds 0"),
    Benchmark("calibrate_imu", SLAM, "bench_calibrate_imu", "--seeds 20", "--seeds 1"),
    Benchmark("mapping", SLAM, "bench_mapping", "--backend sfm --backend ukf", None),
    Benchmark("head_ahead", SLAM, "bench_mapping", "--backend ukf --seeds 170-174", None),
    Benchmark("head_turning", SLAM, "bench_mapping", "--backend ukf --seeds 170-174 --look-around 60", None),
    Benchmark("places", PLACES, "places", "--first 400 --seeds 30", "--seeds 1"),
    Benchmark(
        "rooms", PLACES, "bench_rooms",
        "--worlds home:600-609 plain:600-609 corner:600-609 small:600-604 lookalike:600-604 large:600-609",
        "--worlds small:600",
    ),
    Benchmark(
        "rooms_recorded", PLACES, "bench_rooms",
        f"--recorded {DATA}/redkitchen:0-398 {DATA}/redkitchen:500-698 {DATA}/euroc_v1_01_keyframes", None,
        data=f"{DATA}/euroc_v1_01_keyframes",
    ),
    Benchmark(
        "depth", PLACES, "bench_depth", f"--data {DATA}/redkitchen", f"--data {DATA}/redkitchen --passes 500-698",
        data=f"{DATA}/redkitchen",
    ),
    Benchmark("experiments", PLACES, "bench_experiments", "--seeds 30", None, data=f"{DATA}/redkitchen"),
    Benchmark("stickers", PLACES, "bench_stickers", "--tries 100", "--tries 2"),
    Benchmark("plates", PLACES, "bench_plates", "--first 9000 --tries 50", "--tries 2"),
    Benchmark("registration", PLACES, "bench_registration", "--first 14000 --pairs 200", "--pairs 1 --set known"),
    Benchmark("appearance", PLACES, "bench_appearance", "--step 2", "--step 20", data=f"{DATA}/redkitchen"),
    Benchmark(
        "registration_open3d", PLACES, "bench_registration", "--backend open3d --first 14000 --pairs 200",
        "--backend open3d --pairs 1 --set known",
    ),
    Benchmark(
        "current_place", CURRENT, "bench_current_place",
        "--worlds home:600-624 plain:600-624 lookalike:600-604 --wrong-focal 2", "--worlds small:0",
    ),
    Benchmark(
        "current_place_left_out", CURRENT, "bench_current_place",
        "--worlds home:600-609 plain:600-609 real --wrong-focal 2 --leave-kind-out", None, data=f"{DATA}/redkitchen",
    ),
    Benchmark(
        "current_place_twins", CURRENT, "bench_current_place",
        "--worlds lookalike:600 --wrong-focal 2 --map-all", None,
    ),
    Benchmark(
        "current_place_identical_twins", CURRENT, "bench_current_place",
        "--worlds lookalike:600 --wrong-focal 2 --map-all --identical", None,
    ),
    Benchmark(
        "current_place_one_way", CURRENT, "bench_current_place",
        "--worlds plain:600-624 --wrong-focal 2 --one-way", None,
    ),
    Benchmark(
        "current_place_3", CURRENT, "bench_current_place",
        "--worlds home:600-602 plain:600-602 --wrong-focal 3", None,
    ),
    Benchmark(
        "current_place_5", CURRENT, "bench_current_place",
        "--worlds home:600-602 plain:600-602 --wrong-focal 5", None,
    ),
    Benchmark(
        "current_place_real", CURRENT, "bench_current_place", "--worlds real", None, data=f"{DATA}/redkitchen"
    ),
    Benchmark("false_alarms", CURRENT, "bench_false_alarms", "--seed 270", "--flats 1 --drives 1"),
    Benchmark("hijack", CURRENT, "bench_hijack", "--trials 100", "--trials 2 --plain-minutes 0.5"),
    Benchmark("new_robot", CURRENT, "bench_new_robot", "--seeds 10-14", None),
    Benchmark("demo", CURRENT, "bench_demo", "--seeds 1-20", None),
    Benchmark("place_scale", CURRENT, "bench_place_scale", "--answers 120", "--rooms 1 10 --answers 12"),
    Benchmark("page", PAGE, "bench_page", "--seconds 30", "--seconds 5", has_own_target=True),
    Benchmark("openapi", PAGE, "bench_openapi", "--examples 100", "--examples 2"),
    Benchmark("crash", KEPT, "bench_crash", "--kills 600", "--kills 6"),
    Benchmark("crash_full", KEPT, "bench_crash", "--fault full --kills 60", None),
    Benchmark("crash_read_only", KEPT, "bench_crash", "--fault read-only --kills 60", None),
    Benchmark("flips", KEPT, "bench_flips", "--flips 1000", "--flips 10"),
    Benchmark("replay", KEPT, "bench_replay", "", None),
    Benchmark("days_made_up", KEPT, "bench_days", "--made-up 30 --first 200", "--made-up 1"),
    Benchmark("days", KEPT, "bench_days", "--flats 1-3 --backend ukf --fps 20", None),
)  # fmt: skip
