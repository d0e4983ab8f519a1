//! Compiles `cpp/group.cpp` with the libtorch that tch uses, and with NCCL where that libtorch is a CUDA build and the
//! headers of both are there.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

/// Variables that name the folders of CUDA's and NCCL's headers; Debian's are in the compiler's own path.
const INCLUDES: [&str; 2] = ["CUDA_HOME", "NCCL_HOME"];

/// Headers that c10d's header of NCCL includes, of which PyTorch's wheels bring only some.
const HEADERS: [&str; 7] =
    ["nccl.h", "cuda_runtime_api.h", "crt/host_config.h", "nv/target", "cublas_v2.h", "cusparse.h", "cusolverDn.h"];

fn main() -> Result<(), String> {
    for file in ["cpp/group.cpp", "cpp/gloo", "build.rs"] {
        println!("cargo::rerun-if-changed={file}");
    }
    for name in INCLUDES {
        println!("cargo::rerun-if-env-changed={name}");
    }
    let missing = "torch-sys reports no folder of libtorch; set LIBTORCH, or run `make .libtorch`";
    let lib = PathBuf::from(env::var_os("DEP_TCH_LIBTORCH_LIB").ok_or(missing)?);
    let include = lib.parent().ok_or(missing)?.join("include");
    let mut build = cc::Build::new();
    build
        .cpp(true)
        .std("c++17")
        .file("cpp/group.cpp")
        .define("USE_C10D_GLOO", None)
        .include("cpp")
        // Warnings in libtorch's headers are libtorch's.
        .flag("-isystem")
        .flag(include.display().to_string())
        .flag("-isystem")
        .flag(include.join("torch/csrc/api/include").display().to_string())
        // A thin layer, which waits for the network.
        .opt_level(1);
    if lib.join("libtorch_cuda.so").is_file() {
        build.define("GLEANER_CUDA", None);
        if let Some(folders) = nccl(&lib) {
            build.define("USE_C10D_NCCL", None).define("USE_CUDA", None).includes(folders);
        }
        println!("cargo::rustc-link-lib=torch_cuda");
        if wheels(&lib).is_dir() {
            println!("cargo::rerun-if-changed={}", wheels(&lib).display());
        }
    }
    build.try_compile("gleaner_group").map_err(|error| error.to_string())?;
    println!("cargo::rustc-link-search=native={}", lib.display());
    println!("cargo::rustc-link-lib=torch_cpu");
    println!("cargo::rustc-link-lib=c10");
    Ok(())
}

/// The folder of the wheels of NVIDIA on which PyTorch's depends.
fn wheels(lib: &Path) -> PathBuf {
    lib.join("../../nvidia")
}

/// The folders of CUDA's and NCCL's headers, if they are found.
fn nccl(lib: &Path) -> Option<Vec<PathBuf>> {
    let mut folders: Vec<PathBuf> =
        INCLUDES.iter().filter_map(env::var_os).map(|home| PathBuf::from(home).join("include")).collect();
    // The wheels on which PyTorch's depends have the NCCL with which it was built.
    let wheels = fs::read_dir(wheels(lib)).into_iter().flatten().flatten();
    folders.extend(wheels.map(|wheel| wheel.path().join("include")));
    folders.extend(["/usr/include".into(), "/usr/local/cuda/include".into()]);
    let missing: Vec<&str> =
        HEADERS.into_iter().filter(|header| !folders.iter().any(|folder| folder.join(header).is_file())).collect();
    if missing.is_empty() {
        return Some(
            folders.into_iter().filter(|folder| folder.is_dir() && folder != Path::new("/usr/include")).collect(),
        );
    }
    println!(
        "cargo::warning=libtorch has CUDA, but these headers are not found: {}; sums of several GPUs go through main \
         memory; set NCCL_HOME and CUDA_HOME",
        missing.join(", ")
    );
    None
}
