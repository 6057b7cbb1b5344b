"""Tests ROS 2 without ROS: zenoh-ros2-sdk is the peer, and Zenoh's router runs in this process. PORT FOLDER."""
import os
import pathlib
import sys
import time

import zenoh
import zenoh.ext
import zenoh_ros2_sdk as sdk
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

port, folder = int(sys.argv[1]), pathlib.Path(sys.argv[2])
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("timestamping/enabled", "true")
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
STRING_TYPE = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data\n"}
ADD_TYPE = {"srv_type": "example_interfaces/srv/AddTwoInts", "request_definition": "int64 a\nint64 b",
       "response_definition": "int64 sum"}
SESSION = {"domain_id": 0, "router_port": port}


def wait_until(condition, failure):
    for _ in range(1_200):
        if condition():
            return
        time.sleep(0.05)
    print("FAILED:", failure, flush=True)
    os._exit(1)


router = zenoh.open(config)
tokens = []
seen = router.liveliness().declare_subscriber("@ros2_lv/**", lambda t: tokens.append(str(t.key_expr)), history=True)
received = []
listener = sdk.ROS2Subscriber(
    "/situ/words", **STRING_TYPE, callback=lambda m: received.append(m.data), node_name="listener", **SESSION)
talker = sdk.ROS2Publisher("/chatter", **STRING_TYPE, node_name="talker", **SESSION)
server = None


def handle_add(request):
    if request.a < 0:
        raise ValueError("no debts")
    return server.response_msg_class(sum=request.a + request.b)


server = sdk.ROS2ServiceServer("/add_theirs", **ADD_TYPE, callback=handle_add, node_name="adder", **SESSION)

# A latched publisher like that of rmw_zenoh, which keeps the last three of five words. The SDK's own keeps none.
key = listener.keyexpr.replace("situ/words", "map_theirs")
latched = zenoh.ext.declare_advanced_publisher(
    router, key, cache=zenoh.ext.CacheConfig(max_samples=3), publisher_detection=True,
    sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None))
for n in range(5):
    word = listener.session_mgr.store.serialize_cdr(talker.msg_class(data=f"old {n}"), listener.msg_type)
    latched.put(bytes(word), attachment=Attachment(n + 1, time.time_ns(), bytes(16)).to_bytes())

(folder / "router").touch()
wait_until(lambda: any("/MS/" in t and "%chatter" in t for t in tokens), "Situ's subscriber did not appear")
for n in range(200):
    talker.publish(data=f"hello {n}")
    time.sleep(0.002)
wait_until(lambda: len(received) >= 200, f"only {len(received)} words arrived from Situ")
assert received == [f"word {n}" for n in range(200)], received
assert any("/MP/" in t and "%situ%words" in t for t in tokens), tokens
assert any("/NN/" in t for t in tokens), tokens

# Situ's latched topic: late subscribers receive the last two of five words, and then new ones. The SDK consolidates the
# replies to its query, which leaves only the last word.
wait_until(lambda: (folder / "latched").exists(), "Situ's latched topic did not appear")
assert any("/MP/" in t and "%map_ours" in t and t.endswith("/:1:,2:,:,:,,") for t in tokens), tokens
late, later = [], []
lasting = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=2)
late_listener = sdk.ROS2Subscriber("/map_ours", **STRING_TYPE, callback=lambda m: late.append(m.data), qos=lasting, **SESSION)
advanced = zenoh.ext.declare_advanced_subscriber(
    router, key.replace("map_theirs", "map_ours"), lambda s: later.append(bytes(s.payload)[8:-1].decode()),
    history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=2),
    recovery=zenoh.ext.RecoveryConfig(heartbeat=True), subscriber_detection=True)
wait_until(lambda: (late, later) == (["map 4"], ["map 3", "map 4"]), "late subscribers did not receive the kept words")
(folder / "late").touch()
wait_until(lambda: (late[1:], later[2:]) == (["map 5"], ["map 5"]), "late subscribers did not receive new words")

# Situ's service.
wait_until(lambda: any("/SS/" in t and "%add_ours" in t for t in tokens), "Situ's service did not appear")
client = sdk.ROS2ServiceClient("/add_ours", **ADD_TYPE, timeout=20.0, **SESSION)
for n in range(50):
    assert client.call(a=n, b=2**40).sum == n + 2**40, n
assert client.call(a=-1, b=0) is None, "a refused call must return no response"
(folder / "served").touch()

wait_until(lambda: (folder / "done").exists(), "Situ did not receive everything")
assert any("/SC/" in t and "%add_theirs" in t for t in tokens), tokens
print("ok", flush=True)
# The SDK's threads do not always end.
os._exit(0)
