# To be sourced from the project's folder; the profile of cargo is BENCH_PROFILE (bench), in $profile.
profile="${BENCH_PROFILE:-bench}"

# Builds the server, its inspector, its worker and the packages that are named. The programs are then in $folder.
build() {
  local packages=(-p gleaner-server -p gleaner-inspector -p gleaner-worker) package
  for package in "$@"; do
    packages+=(-p "$package")
  done
  "${CARGO:-cargo}" build --locked --profile "$profile" "${packages[@]}"
  # cargo uses the folders of the parent profiles for these two.
  case "$profile" in
    dev) folder=target/debug ;;
    bench) folder=target/release ;;
    *) folder="target/$profile" ;;
  esac
}
