"""ROS 2 without ROS: zenoh-ros2-sdk beside Situ, with Zenoh's router in this process. PORT FOLDER."""
import os
import pathlib
import sys
import time

import zenoh
import zenoh_ros2_sdk as sdk

port, folder = int(sys.argv[1]), pathlib.Path(sys.argv[2])
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')


def until(condition, what):
    for _ in range(1_200):
        if condition():
            return
        time.sleep(0.05)
    print("FAILED:", what, flush=True)
    os._exit(1)


router = zenoh.open(config)
tokens = []
seen = router.liveliness().declare_subscriber("@ros2_lv/**", lambda t: tokens.append(str(t.key_expr)), history=True)
heard = []
listener = sdk.ROS2Subscriber(
    "/situ/words", "std_msgs/msg/String", msg_definition="string data\n", callback=lambda m: heard.append(m.data),
    node_name="listener", domain_id=0, router_port=port)
talker = sdk.ROS2Publisher(
    "/chatter", "std_msgs/msg/String", msg_definition="string data\n", node_name="talker", domain_id=0,
    router_port=port)
(folder / "router").touch()
until(lambda: any("/MS/" in t and "%chatter" in t for t in tokens), "Situ's subscriber is not seen")
for n in range(200):
    talker.publish(data=f"hello {n}")
    time.sleep(0.002)
until(lambda: len(heard) >= 200, f"only {len(heard)} words of Situ's came")
assert heard == [f"word {n}" for n in range(200)], heard
assert any("/MP/" in t and "%situ%words" in t for t in tokens), tokens
assert any("/NN/" in t for t in tokens), tokens
until(lambda: (folder / "done").exists(), "Situ did not get all")
print("ok", flush=True)
# Its threads do not always end.
os._exit(0)
