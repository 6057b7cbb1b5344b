// Drives depth cameras through their libraries, for Situ.Space.DepthCamera.Library.
//
//   depth_port list                   lists the devices, one per line: driver, tab, address, tab, name
//   depth_port openni2 [URI]          OpenNI 2: PrimeSense, Asus Xtion, Orbbec ...; the default is the first device
//   depth_port freenect [INDEX]       libfreenect: the Kinect for Xbox 360; the default is 0. With fakenect, a drop-in
//                                     for libfreenect, and FAKENECT_PATH it plays recordings of fakenect-record
//
// Frames on standard output are preceded by their length in 4 bytes (big-endian); numbers inside are little-endian,
// like those of the machine:
//
//   0  two lenses (depth, color), each with width, height (32 bits) and focal lengths x and y in pixels (64-bit floats,
//      0 if unknown), followed by the name of the device; a width of 0 means that there is no color
//   1  depth, 2  color: time of arrival in nanoseconds since 1970 (64 bits), number of images dropped before this one
//      (32), width, height (32), followed by the pixels: 16 bits in mm, or 8 bits each of red, green, blue
//
// Each byte on standard input requests an image of the kind with this number. Images that were not requested are
// dropped and counted, because devices do not wait. The last packet has kind 3 and an error message, or kind 4 at the
// end of a recording. The program ends at the end of its input, so that the last packet is read.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <dlfcn.h>
#include <poll.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include <libfreenect.h>
#include <openni2/OniCAPI.h>
#include <openni2/OniCProperties.h>

namespace {

// The libraries write to standard output, so images are written to a separate descriptor.
int out = -1;

struct Lens {
  uint32_t width = 0, height = 0;
  double x = 0, y = 0;
};

// Returns the focal length in pixels, or 0 if the field of view is unknown.
double focal_length(uint32_t pixels, float angle) {
  return angle > 0 && angle < 3 ? pixels / 2.0 / std::tan(angle / 2.0) : 0;
}

void write_all(const uint8_t *at, size_t left) {
  while (left > 0) {
    ssize_t n = write(out, at, left);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) _exit(0);
    at += n;
    left -= n;
  }
}

struct Packet {
  std::vector<uint8_t> bytes = std::vector<uint8_t>(4);
  template <typename T> void put(T value) {
    auto *p = reinterpret_cast<const uint8_t *>(&value);
    bytes.insert(bytes.end(), p, p + sizeof(T));
  }
  void put(const void *data, size_t n) {
    auto *p = static_cast<const uint8_t *>(data);
    bytes.insert(bytes.end(), p, p + n);
  }
  void put(const Lens &lens) {
    put(lens.width);
    put(lens.height);
    put(lens.x);
    put(lens.y);
  }
  void send() {
    uint32_t n = bytes.size() - 4;
    for (int i = 0; i < 4; i++) bytes[i] = n >> (24 - 8 * i);
    write_all(bytes.data(), bytes.size());
  }
};

[[noreturn]] void end_with(uint8_t kind, const std::string &why) {
  Packet packet;
  packet.put(kind);
  packet.put(why.data(), why.size());
  packet.send();
  char requests[64];
  while (read(STDIN_FILENO, requests, sizeof requests) > 0) {
  }
  _exit(0);
}

[[noreturn]] void fail(const std::string &why) { end_with(3, why); }
[[noreturn]] void end_recording() { end_with(4, ""); }

void send_description(const Lens &depth, const Lens &color, const std::string &name) {
  Packet packet;
  packet.put<uint8_t>(0);
  packet.put(depth);
  packet.put(color);
  packet.put(name.data(), name.size());
  packet.send();
}

// A kind of image, with the number of requested images, and of images dropped since the last one sent.
struct ImageQueue {
  uint8_t kind;
  size_t pixel;
  uint32_t requested = 0, dropped = 0;

  void send(const void *data, uint32_t width, uint32_t height, size_t stride) {
    if (requested == 0) {
      dropped++;
      return;
    }
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    Packet packet;
    packet.bytes.reserve(32 + width * height * pixel);
    packet.put(kind);
    packet.put<int64_t>(now.tv_sec * 1000000000LL + now.tv_nsec);
    packet.put(dropped);
    packet.put(width);
    packet.put(height);
    for (uint32_t y = 0; y < height; y++) packet.put(static_cast<const uint8_t *>(data) + y * stride, width * pixel);
    packet.send();
    requested--;
    dropped = 0;
  }
};

ImageQueue depths{1, 2}, colors{2, 3};

// Reads pending requests without waiting.
void read_requests() {
  struct pollfd input = {STDIN_FILENO, POLLIN, 0};
  if (poll(&input, 1, 0) <= 0) return;
  char requests[64];
  ssize_t n = read(STDIN_FILENO, requests, sizeof requests);
  if (n <= 0) _exit(0);
  depths.requested += std::count(requests, requests + n, depths.kind);
  colors.requested += std::count(requests, requests + n, colors.kind);
}

// OpenNI 2 -----------------------------------------------------------------------------------------------------------

const char *openni_error() {
  static std::string text;
  text = oniGetExtendedError();
  while (!text.empty() && isspace(text.back())) text.pop_back();
  while (!text.empty() && isspace(text.front())) text.erase(0, 1);
  return text.c_str();
}

void check_status(OniStatus status, const char *doing) {
  if (status != ONI_STATUS_OK) fail(std::string(doing) + ": " + openni_error());
}

OniVideoMode read_mode(OniStreamHandle stream) {
  OniVideoMode mode{};
  int size = sizeof mode;
  check_status(oniStreamGetProperty(stream, ONI_STREAM_PROPERTY_VIDEO_MODE, &mode, &size), "reading the video mode");
  return mode;
}

Lens read_lens(OniStreamHandle stream) {
  OniVideoMode mode = read_mode(stream);
  float x = 0, y = 0;
  int size = sizeof x;
  oniStreamGetProperty(stream, ONI_STREAM_PROPERTY_HORIZONTAL_FOV, &x, &size);
  size = sizeof y;
  oniStreamGetProperty(stream, ONI_STREAM_PROPERTY_VERTICAL_FOV, &y, &size);
  uint32_t width = mode.resolutionX, height = mode.resolutionY;
  return Lens{width, height, focal_length(width, x), focal_length(height, y)};
}

// Sets the pixel format and keeps the size.
bool set_format(OniStreamHandle stream, OniPixelFormat format) {
  OniVideoMode mode = read_mode(stream);
  if (mode.pixelFormat == format) return true;
  mode.pixelFormat = format;
  return oniStreamSetProperty(stream, ONI_STREAM_PROPERTY_VIDEO_MODE, &mode, sizeof mode) == ONI_STATUS_OK;
}

volatile bool unplugged = false;
std::string open_uri;
void on_disconnect(const OniDeviceInfo *info, void *) {
  if (open_uri.empty() || open_uri == info->uri) unplugged = true;
}

[[noreturn]] void run_openni2(const char *uri) {
  check_status(oniInitialize(ONI_API_VERSION), "starting OpenNI");
  OniDeviceHandle device;
  check_status(oniDeviceOpen(uri, &device), "opening the camera");
  OniDeviceInfo info{};
  oniDeviceGetInfo(device, &info);
  open_uri = info.uri;
  OniDeviceCallbacks callbacks{nullptr, on_disconnect, nullptr};
  OniCallbackHandle handle;
  oniRegisterDeviceCallbacks(&callbacks, nullptr, &handle);

  OniStreamHandle streams[2] = {nullptr, nullptr};
  check_status(oniDeviceCreateStream(device, ONI_SENSOR_DEPTH, &streams[0]), "opening the depth stream");
  if (!set_format(streams[0], ONI_PIXEL_FORMAT_DEPTH_1_MM)) fail("the camera does not support depth in millimetres");
  int count = 1;
  if (oniDeviceCreateStream(device, ONI_SENSOR_COLOR, &streams[1]) == ONI_STATUS_OK) {
    if (set_format(streams[1], ONI_PIXEL_FORMAT_RGB888)) count = 2;
    else oniStreamDestroy(streams[1]);
  }
  check_status(oniStreamStart(streams[0]), "starting the depth stream");
  if (count == 2 && oniStreamStart(streams[1]) != ONI_STATUS_OK) count = 1;

  std::string name = std::string(info.vendor) + (*info.vendor ? " " : "") + info.name;
  send_description(read_lens(streams[0]), count == 2 ? read_lens(streams[1]) : Lens{}, name);

  while (!unplugged) {
    read_requests();
    int which = 0;
    OniStatus status = oniWaitForAnyStream(streams, count, &which, 50);
    if (status == ONI_STATUS_TIME_OUT) continue;
    check_status(status, "waiting for an image");
    OniFrame *frame = nullptr;
    check_status(oniStreamReadFrame(streams[which], &frame), "reading an image");
    // Images may have been requested during the wait.
    read_requests();
    ImageQueue &images = which == 0 ? depths : colors;
    size_t rows = frame->height, wide = frame->width * images.pixel;
    if (frame->stride >= static_cast<int>(wide) &&
        static_cast<size_t>(frame->dataSize) >= (rows - 1) * frame->stride + wide)
      images.send(frame->data, frame->width, frame->height, frame->stride);
    oniFrameRelease(frame);
  }
  fail("the camera was unplugged");
}

void list_openni2() {
  if (oniInitialize(ONI_API_VERSION) != ONI_STATUS_OK) return;
  OniDeviceInfo *devices = nullptr;
  int count = 0;
  if (oniGetDeviceList(&devices, &count) == ONI_STATUS_OK)
    for (int i = 0; i < count; i++) {
      std::string line =
          std::string("openni2\t") + devices[i].uri + "\t" + devices[i].vendor + " " + devices[i].name + "\n";
      write_all(reinterpret_cast<const uint8_t *>(line.data()), line.size());
    }
}

// libfreenect --------------------------------------------------------------------------------------------------------

freenect_frame_mode depth_mode, color_mode;

// Recordings of fakenect contain the raw 11-bit values of the sensor. They are converted to mm like in libfreenect,
// with typical constants of Kinects, which vary by less than the uncertainty of the depth.
const double pixel_mm = 0.1042, reference_mm = 120, emitter_mm = 7.5, shift = 200;
std::vector<uint16_t> millimetres;

std::vector<uint16_t> build_depth_table() {
  std::vector<uint16_t> table(2048, 0);
  for (int raw = 0; raw < 2047; raw++) {
    double offset = ((raw - 4 * shift) / 4 - 0.375) * pixel_mm;
    double depth = 10 * (offset * reference_mm / (emitter_mm - offset) + reference_mm);
    if (depth > 0 && depth < 10000) table[raw] = static_cast<uint16_t>(depth);
  }
  return table;
}

// The rows of a Kinect's images have no padding.
void on_depth(freenect_device *, void *data, uint32_t) {
  read_requests();
  auto *values = static_cast<uint16_t *>(data);
  if (!millimetres.empty() && depths.requested > 0)
    for (int i = 0; i < depth_mode.width * depth_mode.height; i++) values[i] = millimetres[values[i] & 2047];
  depths.send(data, depth_mode.width, depth_mode.height, depth_mode.width * 2);
}

void on_color(freenect_device *, void *data, uint32_t) {
  read_requests();
  colors.send(data, color_mode.width, color_mode.height, color_mode.width * 3);
}

// Returns the focal length in pixels by the calibration of the device, from the position of a point next to the
// center at a distance of one metre. The fakenect library lacks this function.
double measure_focal_length(freenect_device *device) {
  using CameraToWorld = void(freenect_device *, int, int, int, double *, double *);
  auto *camera_to_world = reinterpret_cast<CameraToWorld *>(dlsym(RTLD_DEFAULT, "freenect_camera_to_world"));
  if (camera_to_world == nullptr) return reference_mm / (2 * pixel_mm);
  double x = 0, y = 0;
  camera_to_world(device, depth_mode.width / 2 + 1, depth_mode.height / 2, 1000, &x, &y);
  return x > 0 ? 1000 / x : 0;
}

freenect_context *open_freenect() {
  freenect_context *context = nullptr;
  if (freenect_init(&context, nullptr) < 0) fail("libfreenect cannot start: check that USB is available");
  freenect_set_log_level(context, FREENECT_LOG_ERROR);
  freenect_select_subdevices(context, FREENECT_DEVICE_CAMERA);
  return context;
}

[[noreturn]] void run_freenect(int index) {
  freenect_context *context = open_freenect();
  int count = freenect_num_devices(context);
  if (index >= count)
    fail("there is no Kinect with index " + std::to_string(index) + ": " + std::to_string(count) + " found");
  freenect_device *device = nullptr;
  if (freenect_open_device(context, &device, index) < 0)
    fail("cannot open the Kinect: check that no other program uses it, and that this user has access to the device");

  // Depth is requested in mm and registered to the color camera, so both have the same lens.
  bool recorded = getenv("FAKENECT_PATH") != nullptr;
  if (recorded) millimetres = build_depth_table();
  depth_mode = freenect_find_depth_mode(FREENECT_RESOLUTION_MEDIUM,
                                        recorded ? FREENECT_DEPTH_11BIT : FREENECT_DEPTH_REGISTERED);
  color_mode = freenect_find_video_mode(FREENECT_RESOLUTION_MEDIUM, FREENECT_VIDEO_RGB);
  if (!depth_mode.is_valid || !color_mode.is_valid) fail("libfreenect does not support registered depth or color");
  freenect_set_depth_callback(device, on_depth);
  freenect_set_video_callback(device, on_color);
  if (freenect_set_depth_mode(device, depth_mode) < 0 || freenect_set_video_mode(device, color_mode) < 0 ||
      freenect_start_depth(device) < 0 || freenect_start_video(device) < 0)
    fail("the Kinect failed to start");

  double pixels = measure_focal_length(device);
  auto lens = [&](const freenect_frame_mode &mode) {
    return Lens{static_cast<uint32_t>(mode.width), static_cast<uint32_t>(mode.height), pixels, pixels};
  };
  send_description(lens(depth_mode), lens(color_mode), recorded ? "recording of a Kinect" : "Kinect for Xbox 360");
  for (;;) {
    read_requests();
    struct timeval wait = {0, 50000};
    if (freenect_process_events_timeout(context, &wait) >= 0) continue;
    if (recorded) end_recording();
    fail("the Kinect was unplugged");
  }
}

void list_freenect() {
  freenect_context *context = nullptr;
  if (freenect_init(&context, nullptr) < 0) return;
  freenect_select_subdevices(context, FREENECT_DEVICE_CAMERA);
  for (int i = 0, count = freenect_num_devices(context); i < count; i++) {
    std::string line = "freenect\t" + std::to_string(i) + "\tKinect for Xbox 360\n";
    write_all(reinterpret_cast<const uint8_t *>(line.data()), line.size());
  }
}

}  // namespace

int main(int count, char **words) {
  out = dup(STDOUT_FILENO);
  dup2(STDERR_FILENO, STDOUT_FILENO);
  std::string command = count > 1 ? words[1] : "";
  const char *address = count > 2 && *words[2] ? words[2] : nullptr;

  if (command == "list") {
    list_openni2();
    list_freenect();
    _exit(0);
  }
  if (command == "openni2") run_openni2(address);
  if (command == "freenect") run_freenect(address ? atoi(address) : 0);
  fprintf(stderr, "usage: depth_port list | openni2 [URI] | freenect [INDEX]\n");
  return 2;
}
