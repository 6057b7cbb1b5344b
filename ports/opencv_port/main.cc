// Chessboard corners, camera calibration and stereo with OpenCV's calib3d, for Situ.Space.OpenCV. Frames on standard
// input and output are preceded by their length in 4 bytes (big-endian); numbers inside are little-endian, like those
// of the machine. A request is the byte of its kind, followed by the arguments of its function below. A reply is 0
// and the result, 1 if nothing was found, or 2 and the error message. The program ends at the end of its input.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace {

const uint32_t max_request = 1u << 28;

struct Reader {
  const uint8_t *at, *end;
  template <typename T> T take() {
    T value;
    std::memcpy(&value, take_bytes(sizeof(T)), sizeof(T));
    return value;
  }
  const uint8_t *take_bytes(size_t count) {
    if (count > static_cast<size_t>(end - at)) throw std::runtime_error("the request is too short");
    const uint8_t *from = at;
    at += count;
    return from;
  }
  cv::Mat take_gray() {
    uint32_t width = take<uint32_t>(), height = take<uint32_t>();
    if (width == 0 || height == 0 || width > 16384 || height > 16384)
      throw std::runtime_error("invalid image size: both sides must be 1 to 16384");
    const uint8_t *data = take_bytes(static_cast<size_t>(width) * height);
    return cv::Mat(height, width, CV_8U, const_cast<uint8_t *>(data));
  }
};

struct Writer {
  std::string bytes;
  template <typename T> void put(T value) { bytes.append(reinterpret_cast<const char *>(&value), sizeof(T)); }
};

// Finds the inner corners of a chessboard. Arguments: columns and rows of inner corners, image. Result: x and y of
// each corner, row by row, as 64-bit floats.
bool find_corners(Reader &in, Writer &out) {
  int columns = in.take<uint8_t>(), rows = in.take<uint8_t>();
  cv::Mat gray = in.take_gray();
  std::vector<cv::Point2f> found;
  int flags = cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE;
  if (!cv::findChessboardCorners(gray, cv::Size(columns, rows), found, flags)) return false;
  // The window must not reach a neighbouring corner, whatever the size of the board in the image.
  double nearest = 1e9;
  for (size_t i = 0; i < found.size(); i++) {
    if ((i + 1) % columns != 0) nearest = std::min(nearest, cv::norm(found[i + 1] - found[i]));
    if (i + columns < found.size()) nearest = std::min(nearest, cv::norm(found[i + columns] - found[i]));
  }
  int half = std::max(2, std::min(11, static_cast<int>(nearest / 3)));
  cv::cornerSubPix(gray, found, cv::Size(half, half), cv::Size(-1, -1),
                   cv::TermCriteria(cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 40, 0.001));
  for (const cv::Point2f &p : found) {
    out.put<double>(p.x);
    out.put<double>(p.y);
  }
  return true;
}

// Calibrates a camera. Arguments: size of the images, flags (1: no distortion, 2: only k1 and k2), number of views;
// the number of points of each view, and x, y, z and pixel of each point. Result: root mean square error, focal
// lengths, principal point, k1 k2 p0 p1 k3; the error of each view, and the rotation (axis times angle) and position
// of the frame of its points in the frame of the camera.
bool calibrate_camera(Reader &in, Writer &out) {
  int width = in.take<uint32_t>(), height = in.take<uint32_t>();
  uint8_t kind = in.take<uint8_t>();
  uint32_t views = in.take<uint32_t>();
  std::vector<std::vector<cv::Point3f>> points;
  std::vector<std::vector<cv::Point2f>> pixels;
  for (uint32_t i = 0; i < views; i++) {
    uint32_t count = in.take<uint32_t>();
    points.emplace_back();
    pixels.emplace_back();
    for (uint32_t j = 0; j < count; j++) {
      double v[5];
      for (double &x : v) x = in.take<double>();
      points.back().emplace_back(v[0], v[1], v[2]);
      pixels.back().emplace_back(v[3], v[4]);
    }
  }
  int flags = cv::CALIB_FIX_K3;
  if (kind == 1) flags |= cv::CALIB_FIX_K1 | cv::CALIB_FIX_K2 | cv::CALIB_ZERO_TANGENT_DIST;
  if (kind == 2) flags |= cv::CALIB_ZERO_TANGENT_DIST;
  cv::Mat camera, distortion, view_errors;
  std::vector<cv::Mat> rotations, positions;
  double error = cv::calibrateCamera(points, pixels, cv::Size(width, height), camera, distortion, rotations, positions,
                                     cv::noArray(), cv::noArray(), view_errors, flags);
  out.put<double>(error);
  for (auto at : {cv::Point(0, 0), cv::Point(1, 1), cv::Point(2, 0), cv::Point(2, 1)}) out.put(camera.at<double>(at));
  for (int i = 0; i < 5; i++) out.put(distortion.at<double>(i));
  for (uint32_t i = 0; i < views; i++) {
    out.put(view_errors.at<double>(i));
    for (int j = 0; j < 3; j++) out.put(rotations[i].at<double>(j));
    for (int j = 0; j < 3; j++) out.put(positions[i].at<double>(j));
  }
  return true;
}

// Fills unknown pixels with the smaller disparity of their neighbours in the row, since most of them are hidden by a
// nearer object.
void fill_unknown(cv::Mat &found, int unknown) {
  for (int y = 0; y < found.rows; y++) {
    int16_t *row = found.ptr<int16_t>(y);
    for (int from = 0; from < found.cols; from++) {
      if (row[from] > unknown) continue;
      int to = from;
      while (to < found.cols && row[to] <= unknown) to++;
      int before = from > 0 ? row[from - 1] : INT16_MAX, after = to < found.cols ? row[to] : INT16_MAX;
      if (from > 0 || to < found.cols) std::fill(row + from, row + to, static_cast<int16_t>(std::min(before, after)));
      from = to;
    }
  }
}

// Computes the disparities of a stereo pair. Arguments: minimum disparity, number of disparities (a multiple of 16),
// block size, whether to use the full search, whether to fill unknown pixels, both images. Result: disparities in
// sixteenths of a pixel, 16 bits each; unknown ones are below the minimum.
bool compute_disparity(Reader &in, Writer &out) {
  int least = in.take<int32_t>(), count = in.take<uint32_t>(), block = in.take<uint32_t>();
  bool full = in.take<uint8_t>() != 0, filled = in.take<uint8_t>() != 0;
  cv::Mat left = in.take_gray(), right = in.take_gray(), found;
  if (left.size() != right.size()) throw std::runtime_error("the two images have different sizes");
  auto matcher = cv::StereoSGBM::create(least, count, block, 8 * block * block, 32 * block * block, 1, 31, 5, 50, 2,
                                        full ? cv::StereoSGBM::MODE_HH : cv::StereoSGBM::MODE_SGBM);
  // The matcher skips as many columns as it searches disparities, so extra columns are added on the left.
  int extra = std::max(0, least + count);
  cv::copyMakeBorder(left, left, 0, 0, extra, 0, cv::BORDER_REPLICATE);
  cv::copyMakeBorder(right, right, 0, 0, extra, 0, cv::BORDER_REPLICATE);
  matcher->compute(left, right, found);
  found = found.colRange(extra, found.cols).clone();
  if (filled) fill_unknown(found, 16 * least - 1);
  out.bytes.append(reinterpret_cast<const char *>(found.data), found.total() * 2);
  return true;
}

std::string answer_request(const std::vector<uint8_t> &request) {
  Writer out;
  try {
    Reader in{request.data(), request.data() + request.size()};
    uint8_t kind = in.take<uint8_t>();
    bool found = kind == 1   ? find_corners(in, out)
                 : kind == 2 ? calibrate_camera(in, out)
                 : kind == 3 ? compute_disparity(in, out)
                             : throw std::runtime_error("unknown request");
    return found ? std::string(1, '\0') + out.bytes : std::string(1, '\1');
  } catch (const std::exception &error) {
    return std::string(1, '\2') + error.what();
  }
}

bool read_all(void *to, size_t count) { return std::fread(to, 1, count, stdin) == count; }

}  // namespace

int main() {
  cv::setNumThreads(1);
  cv::redirectError([](int, const char *, const char *, const char *, int, void *) { return 0; });
  for (;;) {
    uint8_t head[4];
    if (!read_all(head, 4)) return 0;
    uint32_t length = head[0] << 24 | head[1] << 16 | head[2] << 8 | head[3];
    if (length > max_request) return 1;
    std::vector<uint8_t> request(length);
    if (!read_all(request.data(), length)) return 0;
    std::string reply = answer_request(request);
    uint32_t size = reply.size();
    uint8_t out[4] = {uint8_t(size >> 24), uint8_t(size >> 16), uint8_t(size >> 8), uint8_t(size)};
    if (std::fwrite(out, 1, 4, stdout) != 4 || std::fwrite(reply.data(), 1, size, stdout) != size) return 1;
    std::fflush(stdout);
  }
}
