"""Measures rospy's publisher and subscriber, for bin/bench bridge-ros1-python.

ros1.py N prints the rate and the CPU time per image in us.
"""
import os
import resource
import sys
import time

import rospy
from sensor_msgs.msg import Image

N = int(sys.argv[1])
SIZE = 1280 * 720 * 3


def cpu_time(who):
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


def run_subscriber():
    rospy.init_node("bench_subscriber", anonymous=True, disable_signals=True)
    done = []

    def on_image(image):
        if int.from_bytes(image.data[:4], "big") == N:
            done.append(True)

    rospy.Subscriber("/pictures", Image, on_image, queue_size=2 * N, buff_size=2**24)
    while not done:
        time.sleep(0.01)
    os._exit(0)


child = os.fork()
if child == 0:
    run_subscriber()

rospy.init_node("bench_publisher", anonymous=True, disable_signals=True)
publisher = rospy.Publisher("/pictures", Image, queue_size=2 * N)
while publisher.get_num_connections() == 0:
    time.sleep(0.01)
pixels = os.urandom(SIZE - 4)
before, began = cpu_time(resource.RUSAGE_SELF), time.monotonic()
for i in range(1, N + 1):
    image = Image(width=1280, height=720, encoding="rgb8", step=1280 * 3, data=i.to_bytes(4, "big") + pixels)
    publisher.publish(image)
os.waitpid(child, 0)
spent = cpu_time(resource.RUSAGE_SELF) - before + cpu_time(resource.RUSAGE_CHILDREN)
print(N / (time.monotonic() - began), spent / N * 1e6)
os._exit(0)
