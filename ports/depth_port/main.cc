// Depth cameras for Situ.Space.DepthCamera.Library, by the libraries that know them.
//
//   depth_port list                   the devices, a line each: driver, tab, address, tab, name
//   depth_port openni2 [URI]          OpenNI 2: PrimeSense, Asus Xtion, Orbbec ...; no URI: the first
//   depth_port freenect [INDEX]       libfreenect: the Kinect for Xbox 360; no index: 0. With libfreenect's other
//                                     library, fakenect, and FAKENECT_PATH: what fakenect-record has recorded
//
// Frames with 4 bytes of length (big-endian) go to standard output; numbers inside are little-endian, as the machine's:
//
//   0  name of the device, after two lenses (depth, colour) of width, height (32 bits), focal lengths x and y in pixels
//      (64-bit floats; 0: the library does not tell); no colour: width 0
//   1  depth, 2  colour: nanoseconds since 1970 when it came (64 bits), pictures lost before it (32), width, height (32),
//      then pixels: 16 bits in mm, or 8 bits each of red, green, blue
//
// Each byte on standard input asks for a picture of the kind that it is. A picture that nobody has asked for is lost, and
// counted: a device does not wait. The last packet is of kind 3 and says why there is no more, or of kind 4: a recording is
// over. The program ends with its input, so that its last words are read.
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

// Libraries write to standard output: pictures have a descriptor of their own.
int out = -1;

struct Lens {
  uint32_t width = 0, height = 0;
  double x = 0, y = 0;
};

// A field of view that is not known is 0, and so is the focal length then.
double focal(uint32_t pixels, float angle) { return angle > 0 && angle < 3 ? pixels / 2.0 / std::tan(angle / 2.0) : 0; }

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

[[noreturn]] void end(uint8_t kind, const std::string &why) {
  Packet packet;
  packet.put(kind);
  packet.put(why.data(), why.size());
  packet.send();
  char asks[64];
  while (read(STDIN_FILENO, asks, sizeof asks) > 0) {
  }
  _exit(0);
}

[[noreturn]] void fail(const std::string &why) { end(3, why); }
[[noreturn]] void over() { end(4, ""); }

void introduce(const Lens &depth, const Lens &color, const std::string &name) {
  Packet packet;
  packet.put<uint8_t>(0);
  packet.put(depth);
  packet.put(color);
  packet.put(name.data(), name.size());
  packet.send();
}

// One kind of picture: how many are asked for, how many were lost since the last that went out.
struct Pictures {
  uint8_t kind;
  size_t pixel;
  uint32_t asked = 0, lost = 0;

  void send(const void *data, uint32_t width, uint32_t height, size_t stride) {
    if (asked == 0) {
      lost++;
      return;
    }
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    Packet packet;
    packet.bytes.reserve(32 + width * height * pixel);
    packet.put(kind);
    packet.put<int64_t>(now.tv_sec * 1000000000LL + now.tv_nsec);
    packet.put(lost);
    packet.put(width);
    packet.put(height);
    for (uint32_t y = 0; y < height; y++) packet.put(static_cast<const uint8_t *>(data) + y * stride, width * pixel);
    packet.send();
    asked--;
    lost = 0;
  }
};

Pictures depths{1, 2}, colors{2, 3};

// Takes what was asked for, without waiting.
void hear() {
  struct pollfd input = {STDIN_FILENO, POLLIN, 0};
  if (poll(&input, 1, 0) <= 0) return;
  char asks[64];
  ssize_t n = read(STDIN_FILENO, asks, sizeof asks);
  if (n <= 0) _exit(0);
  depths.asked += std::count(asks, asks + n, depths.kind);
  colors.asked += std::count(asks, asks + n, colors.kind);
}

// OpenNI 2 -----------------------------------------------------------------------------------------------------------

const char *trimmed() {
  static std::string text;
  text = oniGetExtendedError();
  while (!text.empty() && isspace(text.back())) text.pop_back();
  while (!text.empty() && isspace(text.front())) text.erase(0, 1);
  return text.c_str();
}

void check(OniStatus status, const char *doing) {
  if (status != ONI_STATUS_OK) fail(std::string(doing) + ": " + trimmed());
}

OniVideoMode mode_of(OniStreamHandle stream) {
  OniVideoMode mode{};
  int size = sizeof mode;
  check(oniStreamGetProperty(stream, ONI_STREAM_PROPERTY_VIDEO_MODE, &mode, &size), "asking for the size");
  return mode;
}

Lens lens_of(OniStreamHandle stream) {
  OniVideoMode mode = mode_of(stream);
  float x = 0, y = 0;
  int size = sizeof x;
  oniStreamGetProperty(stream, ONI_STREAM_PROPERTY_HORIZONTAL_FOV, &x, &size);
  size = sizeof y;
  oniStreamGetProperty(stream, ONI_STREAM_PROPERTY_VERTICAL_FOV, &y, &size);
  uint32_t width = mode.resolutionX, height = mode.resolutionY;
  return Lens{width, height, focal(width, x), focal(height, y)};
}

// A camera may begin with another format; the size stays.
bool set_format(OniStreamHandle stream, OniPixelFormat format) {
  OniVideoMode mode = mode_of(stream);
  if (mode.pixelFormat == format) return true;
  mode.pixelFormat = format;
  return oniStreamSetProperty(stream, ONI_STREAM_PROPERTY_VIDEO_MODE, &mode, sizeof mode) == ONI_STATUS_OK;
}

volatile bool gone = false;
std::string opened;
void disconnected(const OniDeviceInfo *info, void *) {
  if (opened.empty() || opened == info->uri) gone = true;
}

[[noreturn]] void openni2(const char *uri) {
  check(oniInitialize(ONI_API_VERSION), "starting OpenNI");
  OniDeviceHandle device;
  check(oniDeviceOpen(uri, &device), "opening the camera");
  OniDeviceInfo info{};
  oniDeviceGetInfo(device, &info);
  opened = info.uri;
  OniDeviceCallbacks callbacks{nullptr, disconnected, nullptr};
  OniCallbackHandle handle;
  oniRegisterDeviceCallbacks(&callbacks, nullptr, &handle);

  OniStreamHandle streams[2] = {nullptr, nullptr};
  check(oniDeviceCreateStream(device, ONI_SENSOR_DEPTH, &streams[0]), "opening its depth");
  if (!set_format(streams[0], ONI_PIXEL_FORMAT_DEPTH_1_MM)) fail("the camera gives no depth in millimetres");
  int count = 1;
  if (oniDeviceCreateStream(device, ONI_SENSOR_COLOR, &streams[1]) == ONI_STATUS_OK) {
    if (set_format(streams[1], ONI_PIXEL_FORMAT_RGB888)) count = 2;
    else oniStreamDestroy(streams[1]);
  }
  check(oniStreamStart(streams[0]), "starting its depth");
  if (count == 2 && oniStreamStart(streams[1]) != ONI_STATUS_OK) count = 1;

  std::string name = std::string(info.vendor) + (*info.vendor ? " " : "") + info.name;
  introduce(lens_of(streams[0]), count == 2 ? lens_of(streams[1]) : Lens{}, name);

  while (!gone) {
    hear();
    int which = 0;
    OniStatus status = oniWaitForAnyStream(streams, count, &which, 50);
    if (status == ONI_STATUS_TIME_OUT) continue;
    check(status, "waiting for a picture");
    OniFrame *frame = nullptr;
    check(oniStreamReadFrame(streams[which], &frame), "reading a picture");
    // Asked for while this one was waited for.
    hear();
    Pictures &pictures = which == 0 ? depths : colors;
    size_t rows = frame->height, wide = frame->width * pictures.pixel;
    if (frame->stride >= static_cast<int>(wide) && static_cast<size_t>(frame->dataSize) >= (rows - 1) * frame->stride + wide)
      pictures.send(frame->data, frame->width, frame->height, frame->stride);
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
      std::string line = std::string("openni2\t") + devices[i].uri + "\t" + devices[i].vendor + " " + devices[i].name + "\n";
      write_all(reinterpret_cast<const uint8_t *>(line.data()), line.size());
    }
}

// libfreenect --------------------------------------------------------------------------------------------------------

freenect_frame_mode depth_mode, color_mode;

// What fakenect plays are the sensor's own numbers of 11 bits. From these to mm as libfreenect does it, with the
// constants that Kinects have (they differ by less than depth is uncertain).
const double pixel_mm = 0.1042, reference_mm = 120, emitter_mm = 7.5, shift = 200;
std::vector<uint16_t> millimetres;

std::vector<uint16_t> table_of_depths() {
  std::vector<uint16_t> table(2048, 0);
  for (int raw = 0; raw < 2047; raw++) {
    double offset = ((raw - 4 * shift) / 4 - 0.375) * pixel_mm;
    double depth = 10 * (offset * reference_mm / (emitter_mm - offset) + reference_mm);
    if (depth > 0 && depth < 10000) table[raw] = static_cast<uint16_t>(depth);
  }
  return table;
}

// Nobody tells the stride of a Kinect's pictures: there is nothing between its rows.
void on_depth(freenect_device *, void *data, uint32_t) {
  hear();
  auto *values = static_cast<uint16_t *>(data);
  if (!millimetres.empty() && depths.asked > 0)
    for (int i = 0; i < depth_mode.width * depth_mode.height; i++) values[i] = millimetres[values[i] & 2047];
  depths.send(data, depth_mode.width, depth_mode.height, depth_mode.width * 2);
}

void on_color(freenect_device *, void *data, uint32_t) {
  hear();
  colors.send(data, color_mode.width, color_mode.height, color_mode.width * 3);
}

// By the device's own calibration: where a point beside the middle, a metre away, is. The library that plays recordings
// has no such function.
double focal_of(freenect_device *device) {
  using Place = void(freenect_device *, int, int, int, double *, double *);
  auto *place = reinterpret_cast<Place *>(dlsym(RTLD_DEFAULT, "freenect_camera_to_world"));
  if (place == nullptr) return reference_mm / (2 * pixel_mm);
  double x = 0, y = 0;
  place(device, depth_mode.width / 2 + 1, depth_mode.height / 2, 1000, &x, &y);
  return x > 0 ? 1000 / x : 0;
}

freenect_context *freenect() {
  freenect_context *context = nullptr;
  if (freenect_init(&context, nullptr) < 0) fail("libfreenect cannot start: is USB there?");
  freenect_set_log_level(context, FREENECT_LOG_ERROR);
  freenect_select_subdevices(context, FREENECT_DEVICE_CAMERA);
  return context;
}

[[noreturn]] void freenect(int index) {
  freenect_context *context = freenect();
  int count = freenect_num_devices(context);
  if (index >= count) fail("there is no Kinect with index " + std::to_string(index) + ": " + std::to_string(count) + " found");
  freenect_device *device = nullptr;
  if (freenect_open_device(context, &device, index) < 0)
    fail("the Kinect cannot be opened: does another program use it, and may this user?");

  // Of a Kinect depth comes in mm, as the colour camera would see it: one lens for both.
  bool recorded = getenv("FAKENECT_PATH") != nullptr;
  if (recorded) millimetres = table_of_depths();
  depth_mode = freenect_find_depth_mode(FREENECT_RESOLUTION_MEDIUM,
                                        recorded ? FREENECT_DEPTH_11BIT : FREENECT_DEPTH_REGISTERED);
  color_mode = freenect_find_video_mode(FREENECT_RESOLUTION_MEDIUM, FREENECT_VIDEO_RGB);
  if (!depth_mode.is_valid || !color_mode.is_valid) fail("libfreenect gives no registered depth, or no colour");
  freenect_set_depth_callback(device, on_depth);
  freenect_set_video_callback(device, on_color);
  if (freenect_set_depth_mode(device, depth_mode) < 0 || freenect_set_video_mode(device, color_mode) < 0 ||
      freenect_start_depth(device) < 0 || freenect_start_video(device) < 0)
    fail("the Kinect does not start");

  double pixels = focal_of(device);
  auto lens = [&](const freenect_frame_mode &mode) {
    return Lens{static_cast<uint32_t>(mode.width), static_cast<uint32_t>(mode.height), pixels, pixels};
  };
  introduce(lens(depth_mode), lens(color_mode), recorded ? "recording of a Kinect" : "Kinect for Xbox 360");
  for (;;) {
    hear();
    struct timeval wait = {0, 50000};
    if (freenect_process_events_timeout(context, &wait) >= 0) continue;
    if (recorded) over();
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
  if (command == "openni2") openni2(address);
  if (command == "freenect") freenect(address ? atoi(address) : 0);
  fprintf(stderr, "usage: depth_port list | openni2 [URI] | freenect [INDEX]\n");
  return 2;
}
