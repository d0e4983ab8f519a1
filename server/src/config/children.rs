//! The environment of the processes that the server starts.

/// What of this process's environment a worker gets: where programs and libraries are, which devices may be
/// used, and what to log. Nothing else, so that no secret of the server's reaches it; the credentials of a bucket neither,
/// because workers read at signed URLs and store by the server.
pub fn worker_environment() -> Vec<(&'static str, std::ffi::OsString)> {
    const PASSED: [&str; 11] = [
        "PATH",
        "HOME",
        "TMPDIR",
        "TZ",
        "LANG",
        "LD_LIBRARY_PATH",
        "CUDA_VISIBLE_DEVICES",
        "MKL_NUM_THREADS",
        "RUST_BACKTRACE",
        "GLEANER_LOG",
        "GLEANER_LOG_JSON",
    ];
    environment(&PASSED)
}

/// What of this process's environment the commands of a cluster get, and by them the workers on its nodes: as
/// [`worker_environment`], without what is true of this machine only, and with the path of Slurm's configuration.
pub fn cluster_environment() -> Vec<(&'static str, std::ffi::OsString)> {
    environment(&[
        "PATH",
        "HOME",
        "LANG",
        "LD_LIBRARY_PATH",
        "RUST_BACKTRACE",
        "GLEANER_LOG",
        "GLEANER_LOG_JSON",
        "SLURM_CONF",
    ])
}

fn environment(passed: &[&'static str]) -> Vec<(&'static str, std::ffi::OsString)> {
    let passed = passed.iter().filter_map(|&name| std::env::var_os(name).map(|value| (name, value)));
    #[cfg(feature = "fail-points")]
    use gleaner_data_folder::fail_point::VARIABLE;
    #[cfg(feature = "fail-points")]
    let passed = passed.chain(std::env::var_os(VARIABLE).map(|name| (VARIABLE, name)));
    // Threads that wait must sleep: beside any other busy process, spinning ones make each step take ten times as long.
    passed.chain([("OMP_WAIT_POLICY", "PASSIVE".into())]).collect()
}
