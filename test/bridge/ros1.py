"""rospy's side of the ROS 1 test.

`imu FROM` publishes until it is killed. `peer` receives images, calls and offers services, and sets parameters.
"""
import signal
import sys

import rospy
from sensor_msgs.msg import Image, Imu
from std_srvs.srv import SetBool, SetBoolResponse

# The process ends on its own if it is left running.
signal.alarm(180)
role = sys.argv[1]
rospy.init_node(f"theirs_{role}", disable_signals=True)

if role == "imu":
    imu, n = rospy.Publisher("/imu", Imu, queue_size=1_000), int(sys.argv[2])
    while True:
        n += 1
        message = Imu()
        message.header.stamp = rospy.Time(n, 7)
        message.linear_acceleration.z = n / 2
        imu.publish(message)
        rospy.sleep(0.01)

received = []


def on_image(message):
    i = len(received) + 1
    assert (message.width, message.height, message.encoding) == (4, 2, "rgb8"), message
    assert message.header.stamp == rospy.Time(i, 5), message.header
    assert message.data == bytes([i, 2, 3] * 8)
    received.append(i)


rospy.Subscriber("/pictures", Image, on_image, queue_size=1_000)
rospy.Service("/flip_theirs", SetBool, lambda request: SetBoolResponse(not request.data, "from rospy"))
rospy.set_param("/from_rospy", {"list": [1, 2.5, "three", True]})
rospy.wait_for_service("/flip_ours", timeout=60)
response = rospy.ServiceProxy("/flip_ours", SetBool)(True)
assert (response.success, response.message) == (False, "from situ"), response
assert rospy.get_param("/from_situ") == [1, "two", {"x": 1.5}], rospy.get_param("/from_situ")
for _ in range(600):
    if len(received) >= 50 and rospy.has_param("/done"):
        break
    rospy.sleep(0.1)
assert len(received) == 50, len(received)
