//! Beside the workspace's own places, the program looks for libtorch where its tarball has it: `bin/` beside `lib/`.

fn main() {
    println!("cargo:rustc-link-arg-bins=-Wl,-rpath,$ORIGIN/../lib");
    println!("cargo:rerun-if-changed=build.rs");
}
