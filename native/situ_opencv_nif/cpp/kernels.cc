// The OpenCV kernels of situ_opencv_nif. The caller owns the memory of both images, and no exception escapes.
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

extern "C" {

struct situ_image {
  uint8_t *data;
  int32_t width, height;
  int64_t stride;
  int32_t channels, depth;  // depth: bytes per channel, 1 or 2
};
}

namespace {

cv::Mat to_mat(const situ_image &p) {
  int type = CV_MAKETYPE(p.depth == 2 ? CV_16U : CV_8U, p.channels);
  return cv::Mat(p.height, p.width, type, p.data, static_cast<size_t>(p.stride));
}

cv::Scalar to_scalar(const double *v) { return cv::Scalar(v[0], v[1], v[2], v[3]); }

// Kernels run on the thread of the caller. This is set only once, because setting it is neither cheap nor safe while
// a kernel is running.
void use_single_thread() {
  static std::once_flag once;
  std::call_once(once, [] { cv::setNumThreads(1); });
}

// Runs `f(src, dst)`, and ensures that OpenCV wrote into our memory and did not allocate_binary its own.
template <typename F>
int run_guarded(const situ_image *src, situ_image *dst, char *error, size_t room, F f) {
  try {
    use_single_thread();
    cv::Mat from = to_mat(*src), to = to_mat(*dst);
    f(from, to);
    if (to.data != dst->data) {
      if (to.size() != cv::Size(dst->width, dst->height) || to.type() != to_mat(*dst).type()) {
        std::snprintf(error, room, "OpenCV returned an image of a different size or type");
        return 1;
      }
      cv::Mat target = to_mat(*dst);
      to.copyTo(target);
    }
    return 0;
  } catch (const std::exception &e) {
    std::snprintf(error, room, "%s", e.what());
  } catch (...) {
    std::snprintf(error, room, "unknown C++ exception");
  }
  return 1;
}

const int INTERPOLATIONS[] = {cv::INTER_NEAREST, cv::INTER_LINEAR, cv::INTER_CUBIC};
const int BORDERS[] = {cv::BORDER_CONSTANT, cv::BORDER_REPLICATE};
const int MORPHS[] = {cv::MORPH_ERODE, cv::MORPH_DILATE, cv::MORPH_OPEN, cv::MORPH_CLOSE};

}  // namespace

extern "C" {

int situ_warp_affine(const situ_image *src, situ_image *dst, const double *matrix, int interpolation, int border,
                     const double *color, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) {
    cv::Mat m(2, 3, CV_64F, const_cast<double *>(matrix));
    cv::warpAffine(from, to, m, to.size(), INTERPOLATIONS[interpolation], BORDERS[border], to_scalar(color));
  });
}

int situ_warp_perspective(const situ_image *src, situ_image *dst, const double *matrix, int interpolation,
                          int border, const double *color, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) {
    cv::Mat m(3, 3, CV_64F, const_cast<double *>(matrix));
    cv::warpPerspective(from, to, m, to.size(), INTERPOLATIONS[interpolation], BORDERS[border], to_scalar(color));
  });
}

int situ_resize_bilinear(const situ_image *src, situ_image *dst, char *error, size_t room) {
  return run_guarded(src, dst, error, room,
                 [&](cv::Mat &from, cv::Mat &to) { cv::resize(from, to, to.size(), 0, 0, cv::INTER_LINEAR); });
}

int situ_gaussian(const situ_image *src, situ_image *dst, int size, double sigma, char *error, size_t room) {
  return run_guarded(src, dst, error, room,
                 [&](cv::Mat &from, cv::Mat &to) { cv::GaussianBlur(from, to, cv::Size(size, size), sigma); });
}

int situ_box_blur(const situ_image *src, situ_image *dst, int size, char *error, size_t room) {
  return run_guarded(src, dst, error, room,
                     [&](cv::Mat &from, cv::Mat &to) { cv::blur(from, to, cv::Size(size, size)); });
}

int situ_median_blur(const situ_image *src, situ_image *dst, int size, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) { cv::medianBlur(from, to, size); });
}

int situ_canny(const situ_image *src, situ_image *dst, double low, double high, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) { cv::Canny(from, to, low, high); });
}

// The mean of |d/dx| and |d/dy| of a 3x3 Sobel filter, as 8 bits.
int situ_sobel(const situ_image *src, situ_image *dst, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) {
    cv::Mat x, y, ax, ay;
    cv::Sobel(from, x, CV_16S, 1, 0);
    cv::Sobel(from, y, CV_16S, 0, 1);
    cv::convertScaleAbs(x, ax);
    cv::convertScaleAbs(y, ay);
    cv::addWeighted(ax, 0.5, ay, 0.5, 0, to);
  });
}

int situ_morphology(const situ_image *src, situ_image *dst, int kind, int size, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) {
    cv::Mat element = cv::getStructuringElement(cv::MORPH_RECT, cv::Size(size, size));
    cv::morphologyEx(from, to, MORPHS[kind], element);
  });
}

int situ_equalize(const situ_image *src, situ_image *dst, char *error, size_t room) {
  return run_guarded(src, dst, error, room, [&](cv::Mat &from, cv::Mat &to) { cv::equalizeHist(from, to); });
}
}
