//! Finds libsoxr (package libsoxr-dev on Debian). Its C functions are declared in src/audio/soxr.rs.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if let Err(error) = pkg_config::Config::new()
        .atleast_version("0.1.2")
        .probe("soxr")
    {
        println!("cargo:warning=libsoxr was not found; on Debian, install libsoxr-dev");
        eprintln!("{error}");
        std::process::exit(1);
    }
}
