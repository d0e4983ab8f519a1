//! The environment of the processes that the server starts.

/// What of this process's environment a worker gets: where programs and libraries are, which devices may be
/// used, and what to log. Nothing else, so that no secret of the server's reaches it.
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

/// The credentials of a bucket, for the workers of a data folder that has one. Workers use the whole data folder, so they
/// are trusted as the server is; inspections never get them.
pub fn bucket_environment() -> Vec<(&'static str, std::ffi::OsString)> {
    const PASSED: [&str; 11] = [
        "AWS_ACCESS_KEY_ID",
        "AWS_SECRET_ACCESS_KEY",
        "AWS_SESSION_TOKEN",
        "AWS_REGION",
        "AWS_DEFAULT_REGION",
        "AWS_ENDPOINT_URL",
        "AWS_ROLE_ARN",
        "AWS_ROLE_SESSION_NAME",
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    ];
    PASSED.iter().filter_map(|&name| std::env::var_os(name).map(|value| (name, value))).collect()
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
