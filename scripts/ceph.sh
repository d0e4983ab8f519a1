#!/usr/bin/env bash
# Runs a command beside a private Ceph with an S3 gateway: three storage daemons on files in a temporary folder, each object
# on two of them. GLEANER_TEST_S3 names the gateway, whose bucket is `lab`, and GLEANER_TEST_CEPH_DAEMON the file with the
# process id of one storage daemon, for tests that kill it.
#
#   scripts/ceph.sh COMMAND…
#
# Needs root. Installs Debian's ceph-mon, ceph-mgr, ceph-osd and radosgw if they are missing. Where a file system is slow to
# sync, TMPDIR can name a folder in memory (about 2 GB).
set -euo pipefail
[ $# -gt 0 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
[ "$(id -u)" = 0 ] || { echo "scripts/ceph.sh needs root" >&2; exit 1; }
if ! { command -v radosgw && command -v ceph-osd; } >/dev/null; then
  install=(apt-get install -qq -y --no-install-recommends ceph-mon ceph-mgr ceph-osd radosgw)
  "${install[@]}" || { apt-get update -qq && "${install[@]}"; }
fi

folder=$(mktemp -d)
export CEPH_CONF=$folder/ceph.conf CEPH_ARGS=
daemons=(0 1 2)

finish() {
  for file in "$folder"/run/*.pid; do
    [ -s "$file" ] && kill -9 "$(cat "$file")" 2>/dev/null || true
  done
  rm -rf "$folder"
}
trap finish EXIT

# Waits at most a minute until a command succeeds.
until_it() {
  for _ in $(seq 300); do "$@" >/dev/null 2>&1 && return; sleep 0.2; done
  tail -n 20 "$folder"/*.log >&2
  echo "scripts/ceph.sh: failed for a minute: $*" >&2
  exit 1
}

# The first port of a free range.
free_ports() {
  python3 - "$1" <<'PYTHON'
import random, socket, sys
for _ in range(100):
    first = random.randrange(20000, 30000)
    try:
        for port in range(first, first + int(sys.argv[1])):
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", port))
    except OSError:
        continue
    print(first)
    break
else:
    sys.exit("scripts/ceph.sh: no range of free ports between 20000 and 30000 was found; end other programs")
PYTHON
}

port=$(free_ports 40)
monitor=v1:127.0.0.1:$((port + 1))
id=$(cat /proc/sys/kernel/random/uuid)
mkdir -p "$folder/run" "$folder/mon" "$folder/mgr/a"
cat >"$CEPH_CONF" <<CONF
[global]
fsid = $id
mon_host = $monitor
public_network = 127.0.0.0/8
auth_cluster_required = none
auth_service_required = none
auth_client_required = none
keyring = $folder/keyring
run_dir = $folder/run
admin_socket = $folder/run/\$name.asok
pid_file = $folder/run/\$name.pid
log_file = $folder/\$name.log
mon_data = $folder/mon/\$id
mon_cluster_log_file = $folder/cluster.log
mon_max_pg_per_osd = 1000
mon_osd_min_down_reporters = 1
mgr_data = $folder/mgr/\$id
mgr_initial_modules =
osd_data = $folder/osd\$id
osd_objectstore = bluestore
bluestore_block_size = 4294967296
osd_memory_target = 939524096
osd_class_update_on_start = false
osd_crush_chooseleaf_type = 0
osd_heartbeat_interval = 1
osd_heartbeat_grace = 4
osd_pool_default_size = 2
osd_pool_default_min_size = 1
osd_pool_default_pg_num = 8
osd_pool_default_pg_autoscale_mode = off
ms_bind_port_min = $((port + 2))
ms_bind_port_max = $((port + 39))
[client.rgw]
rgw_frontends = beast endpoint=127.0.0.1:$port
CONF
monmaptool --create --clobber --addv a "[$monitor]" --fsid "$id" "$folder/monmap" >/dev/null
ceph-mon -i a --mkfs --monmap "$folder/monmap"
ceph-mon -i a
ceph-mgr -i a

# A storage daemon that asks the monitor too early ends; it is started again.
is_up() {
  kill -0 "$(cat "$folder/run/osd.$1.pid" 2>/dev/null || echo 0x)" 2>/dev/null || ceph-osd -i "$1"
  ceph osd dump | grep -q "^osd.$1 up"
}
for daemon in "${daemons[@]}"; do
  until_it ceph osd create
  mkdir "$folder/osd$daemon"
  ceph-osd -i "$daemon" --mkfs >>"$folder/mkfs.log" 2>&1
done
for daemon in "${daemons[@]}"; do until_it is_up "$daemon"; done

radosgw-admin user create --uid=gleaner --display-name=gleaner --access-key=test --secret-key=testtest >"$folder/user.log" 2>&1
radosgw -n client.rgw
export GLEANER_TEST_S3=http://127.0.0.1:$port GLEANER_TEST_CEPH_DAEMON=$folder/run/osd.1.pid

make_bucket() {
  local date signature
  date=$(LC_ALL=C date -u '+%a, %d %b %Y %H:%M:%S GMT')
  signature=$(printf 'PUT\n\n\n%s\n/lab' "$date" | openssl dgst -sha1 -hmac testtest -binary | base64)
  curl -sf -X PUT -H "Date: $date" -H "Authorization: AWS test:$signature" "$GLEANER_TEST_S3/lab"
}
until_it make_bucket
"$@"
