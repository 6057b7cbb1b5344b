//! Compiles the C++ file against OpenCV 4 of Debian (libopencv-core-dev, libopencv-imgproc-dev). The split packages
//! have no pkg-config file; OPENCV_INCLUDE_DIR overrides the path of the headers.

fn main() {
    println!("cargo:rerun-if-changed=cpp/kernels.cc");
    println!("cargo:rerun-if-env-changed=OPENCV_INCLUDE_DIR");
    let include =
        std::env::var("OPENCV_INCLUDE_DIR").unwrap_or_else(|_| "/usr/include/opencv4".to_string());
    if !std::path::Path::new(&include)
        .join("opencv2/imgproc.hpp")
        .exists()
    {
        println!(
            "cargo:warning=OpenCV's headers are not in {include}; install libopencv-imgproc-dev"
        );
        std::process::exit(1);
    }
    cc::Build::new()
        .cpp(true)
        .std("c++17")
        .opt_level(2)
        .include(&include)
        .file("cpp/kernels.cc")
        .compile("situ_opencv_kernels");
    println!("cargo:rustc-link-lib=opencv_imgproc");
    println!("cargo:rustc-link-lib=opencv_core");
}
