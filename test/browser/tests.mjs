// Runs all browser tests of the studio, in this order.
import { runAll } from "./harness.mjs";
import "./start_tests.mjs";
import "./page_tests.mjs";
import "./timeline_tests.mjs";
import "./picture_tests.mjs";
import "./video_tests.mjs";
import "./truth_tests.mjs";
import "./random_tests.mjs";
import "./window_tests.mjs";
import "./cursor_tests.mjs";
import "./live_tests.mjs";
import "./together_tests.mjs";
import "./pipeline_tests.mjs";
import "./layout_tests.mjs";
import "./bookmark_tests.mjs";
import "./annotation_tests.mjs";
import "./tier_tests.mjs";
import "./session_tests.mjs";
import "./dataset_tests.mjs";
import "./experiment_tests.mjs";
import "./space_tests.mjs";
import "./plugin_tests.mjs";
import "./mask_tests.mjs";
import "./map_tests.mjs";
import "./sensor_tests.mjs";
import "./headset_tests.mjs";
import "./work_tests.mjs";
import "./page_file_tests.mjs";
import "./compare_tests.mjs";
import "./derived_tests.mjs";
import "./settings_tests.mjs";
import "./access_tests.mjs";
import "./serving_tests.mjs";
import "./viewer_tests.mjs";
import "./proxy_tests.mjs";
import "./speed_tests.mjs";

const good = await runAll({
  filter: process.argv[3] ?? "",
  times: Number(process.env.TIMES ?? 1),
  shots: process.env.SHOTS,
});
process.exit(good ? 0 : 1);
