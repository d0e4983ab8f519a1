-- A database of schema 8, as the first finished gleaner left it: pushed, labelled, pretrained, trained, deployed.
pragma foreign_keys = off;
BEGIN TRANSACTION;
CREATE TABLE _sqlx_migrations (
    version BIGINT PRIMARY KEY,
    description TEXT NOT NULL,
    installed_on TIMESTAMP NOT NULL DEFAULT CURRENT_TIMESTAMP,
    success BOOLEAN NOT NULL,
    checksum BLOB NOT NULL,
    execution_time BIGINT NOT NULL
);
INSERT INTO "_sqlx_migrations" VALUES(1,'task','2026-11-21 06:40:36',1,X'FA71821A2BF611125622DE0E9B96895FFD5D2168576677FC0D31DC3B0EAFA2025267A853DBA4A1AE418BB9E4207AE9E1',2070614);
INSERT INTO "_sqlx_migrations" VALUES(2,'episode','2026-11-21 06:40:36',1,X'DDA2A2BFE2528395630EC934DAC4BF34EC1A4875F47120511D015664F76F10FE5033EF6675E513A179F6F8279845B527',1233611);
INSERT INTO "_sqlx_migrations" VALUES(3,'snapshot','2026-11-21 06:40:36',1,X'644FF300CDAA7D5E4FC4E0CDC456A5148252ED6D96394ABFCC35C2BBCD3B782D039BFBE532FBD0D9776474F1BE1D5781',601142);
INSERT INTO "_sqlx_migrations" VALUES(4,'job','2026-11-21 06:40:36',1,X'8C62F6727570862D0E600862BBD5316F4990A5DFD169956574404A8D6B7C67FAE8A607BA154785859B59774737EAD80B',794099);
INSERT INTO "_sqlx_migrations" VALUES(5,'score','2026-11-21 06:40:36',1,X'0F93457A1FA1E05B3B6EE04A927918E463F67EF0391A60818DEC3E733D73B8AD6B790E7376EB676AB700A3D9B773A3CE',656345);
INSERT INTO "_sqlx_migrations" VALUES(6,'dataset','2026-11-21 06:40:36',1,X'DC03014775B5541BFF32449A3E8CAD79218635C048978F65A429EC580958B18B9C91FB5FDFB86C5E2C666C27629C3F14',3689668);
INSERT INTO "_sqlx_migrations" VALUES(7,'policy','2026-11-21 06:40:36',1,X'9E064267E96C53723CD0AE84AD4AF8459B23FB68DCE41A01AEC4A4096929332486AB255365BC401A104AC7FFB5C60AA5',814660);
INSERT INTO "_sqlx_migrations" VALUES(8,'schedule','2026-11-21 06:40:36',1,X'F5B32CE001D764DE5B04B0822E8BD955E14A79C25EB17282C143C7EA6ABC5556D41E740CF0C5786EAF7874292F47D00C',463929);
CREATE TABLE datasets (
    id text primary key,
    task_id text not null references tasks (id),
    score_run_id text not null references jobs (result_id),
    beta real not null check (beta between 0 and 1),
    created_at integer not null
) strict;
CREATE TABLE deployment_changes (
    id integer primary key,
    name text not null references deployments (name),
    policy_id text not null references policies (id),
    created_at integer not null
) strict;
INSERT INTO "deployment_changes" VALUES(1,'pick_cube@test','pol_01M7YDBT4FWA0ZN3MTB8D0W7PS',1795243239893);
INSERT INTO "deployment_changes" VALUES(2,'x@prod','pol_01M7YDBT4FWA0ZN3MTB8D0W7PS',1795243239899);
CREATE TABLE deployments (
    name text primary key,
    task_id text not null references tasks (id)
) strict;
INSERT INTO "deployments" VALUES('pick_cube@test','task_01M7YDBPV65VN7BAH0STQD3JXY');
INSERT INTO "deployments" VALUES('x@prod','task_01M7YDBPV65VN7BAH0STQD3JXY');
CREATE TABLE encoders (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    snapshot_id text not null references snapshots (id),
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;
INSERT INTO "encoders" VALUES('enc_01M7YDBSWN8W2V33ZY2B3RTEMK','task_01M7YDBPV65VN7BAH0STQD3JXY','job_01M7YDBSWN8W2V33ZY2B3RTEMM','snap_01M7YDBSWN8W2V33ZY2B3RTEMJ','323db1f66391d53e70e316154e570f5518593a19870090d74ed25b766a803ddd',1795243239566);
CREATE TABLE episode_scores (
    score_run_id text not null references score_runs (id),
    position integer not null,
    episode_id text not null references episodes (id),
    role text not null check (role in ('expert', 'imperfect')),
    w blob not null,                 -- f64
    q blob not null,                 -- f32
    match_episode blob not null,     -- u32
    match_step blob not null,        -- u32
    distances blob not null,         -- f32: o, m, a for each step
    primary key (score_run_id, position),
    unique (score_run_id, episode_id)
) strict;
CREATE TABLE episodes (
    id text primary key,
    task_id text not null references tasks (id),
    file_name text not null,
    recording text not null,         -- blob: BLAKE3 of the MCAP, hex
    size_bytes integer not null,
    steps integer not null,
    duration_s real not null,
    mapping text not null,           -- which of the task's mappings fitted
    warnings integer not null,       -- findings of severity warning
    report text not null,            -- JSON of the recording crate's Report
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    created_at integer not null,
    unique (task_id, recording)      -- the same content twice is the same episode
) strict;
INSERT INTO "episodes" VALUES('ep_01M7YDBQ4JW36Z4D9E30MMZ6D3','task_01M7YDBPV65VN7BAH0STQD3JXY','0001.mcap','2e6c63a5771176ea401fcc93e05d0ff16c5030d3f28c0bea0919454d5f977d0e',24886,23,2.2,'gleaner',0,'{"mapping":"gleaner","messages":138,"steps":23,"duration_ns":2200000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":23,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":23,"used":true}],"findings":[]}','success','expert',1795243236498);
INSERT INTO "episodes" VALUES('ep_01M7YDBQCT1Z2Z0ZPS7MGXWRB4','task_01M7YDBPV65VN7BAH0STQD3JXY','0002.mcap','25387e823b279c743c47b2af426059619ed8a168c2741d0adbf94f4226031c7e',22503,21,2.0,'gleaner',0,'{"mapping":"gleaner","messages":126,"steps":21,"duration_ns":2000000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":21,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":21,"used":true}],"findings":[]}','success','expert',1795243236762);
INSERT INTO "episodes" VALUES('ep_01M7YDBQMWVKVHN3FNPEB0ZNH8','task_01M7YDBPV65VN7BAH0STQD3JXY','0003.mcap','29df8a0b5195433ad63380ce26cc5bca2ea96a5481679efb85e464ded520f290',28523,28,2.7,'gleaner',0,'{"mapping":"gleaner","messages":168,"steps":28,"duration_ns":2700000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":28,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":28,"used":true}],"findings":[]}','success','expert',1795243237020);
INSERT INTO "episodes" VALUES('ep_01M7YDBQWK7Y6YHCY73P3KBKJ4','task_01M7YDBPV65VN7BAH0STQD3JXY','0004.mcap','8e799a90ab38c214e592556a6ea7051e1780fcebe96f84028841cca07b5f48f6',25934,26,2.5,'gleaner',0,'{"mapping":"gleaner","messages":156,"steps":26,"duration_ns":2500000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":26,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":26,"used":true}],"findings":[]}','success','expert',1795243237267);
INSERT INTO "episodes" VALUES('ep_01M7YDBR4D02KS3CA489GEX7BD','task_01M7YDBPV65VN7BAH0STQD3JXY','0005.mcap','e615403de43abe2fedde998cb992c7f2ac6a777c38f541c655a6afc7e6c57fb9',27668,27,2.6,'gleaner',0,'{"mapping":"gleaner","messages":162,"steps":27,"duration_ns":2600000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":27,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":27,"used":true}],"findings":[]}','success','expert',1795243237517);
INSERT INTO "episodes" VALUES('ep_01M7YDBRC6QC6B0SWGSQH8NQNM','task_01M7YDBPV65VN7BAH0STQD3JXY','0006.mcap','2b4409e7c4a5a781c00e98cfce379be989435049694b0c714f14c1f2d5dea705',23619,22,2.1,'gleaner',0,'{"mapping":"gleaner","messages":132,"steps":22,"duration_ns":2100000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":22,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":22,"used":true}],"findings":[]}','success','expert',1795243237766);
INSERT INTO "episodes" VALUES('ep_01M7YDBRMNH5QDWQSANSSS58QX','task_01M7YDBPV65VN7BAH0STQD3JXY','0007.mcap','b96a3803d2c768a084aee92a9055bed814412fdc43124d197ab7c6256a52b13c',46575,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795243238037);
INSERT INTO "episodes" VALUES('ep_01M7YDBRWNQYNRBP3Y89EEZ608','task_01M7YDBPV65VN7BAH0STQD3JXY','0008.mcap','f4c6a4acf331ff62a4a2a622aa3cb9ebdf9a6ffa660b04e609483e0ec9fa6bc9',49008,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795243238293);
INSERT INTO "episodes" VALUES('ep_01M7YDBS4HW2NECD25JAJVG6K0','task_01M7YDBPV65VN7BAH0STQD3JXY','0009.mcap','d639803f841ad60f485049695b7cf3d8e3c325e7da788639b31f2c58acebce8d',44222,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795243238545);
INSERT INTO "episodes" VALUES('ep_01M7YDBSCFGZQM50C9K9K9E6R5','task_01M7YDBPV65VN7BAH0STQD3JXY','0010.mcap','96049417818710f38d3beba8aed8aadacedaac20279c000a90e752dbf4a01645',53597,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795243238799);
INSERT INTO "episodes" VALUES('ep_01M7YDBSMJSJNA6DB4SKYEF8ED','task_01M7YDBPV65VN7BAH0STQD3JXY','0011.mcap','dc3d57f313697f1bb3c77425570bc5c85fb993b91df09dfb91fb8cd78365ee79',50759,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795243239058);
INSERT INTO "episodes" VALUES('ep_01M7YDBSWK4RZ9S3BGTV7SKK3N','task_01M7YDBPV65VN7BAH0STQD3JXY','0012.mcap','75ef6a7bcbc57f74652cd6eef57549d2bf4d40388090905505e5747abc02a450',51558,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795243239315);
CREATE TABLE export_files (
    export_id text not null references exports (id),
    position integer not null,
    name text not null,
    blob text not null,
    size_bytes integer not null,
    primary key (export_id, position),
    unique (export_id, name)
) strict, without rowid;
CREATE TABLE exports (
    id text primary key,
    dataset_id text not null references datasets (id),
    job_id text not null references jobs (id),
    created_at integer not null
) strict;
CREATE TABLE job_dependencies (
    job_id text not null references jobs (id),
    needs text not null references jobs (id),
    primary key (job_id, needs)
) strict, without rowid;
INSERT INTO "job_dependencies" VALUES('job_01M7YDBT4FWA0ZN3MTB8D0W7PT','job_01M7YDBSWN8W2V33ZY2B3RTEMM');
CREATE TABLE job_metrics (
    -- The order of arrival, where `watch` goes on; never used again when a resumed job's metrics are cut back.
    id integer primary key autoincrement,
    job_id text not null references jobs (id),
    step integer not null,
    name text not null,
    value real not null
) strict;
INSERT INTO "job_metrics" VALUES(1,'job_01M7YDBSWN8W2V33ZY2B3RTEMM',1,'loss',6.59161090850830078125e+00);
INSERT INTO "job_metrics" VALUES(2,'job_01M7YDBSWN8W2V33ZY2B3RTEMM',1,'loss_mtp',1.92219197750091552734e+00);
INSERT INTO "job_metrics" VALUES(3,'job_01M7YDBSWN8W2V33ZY2B3RTEMM',1,'loss_tr',2.33087086677551269531e+00);
INSERT INTO "job_metrics" VALUES(4,'job_01M7YDBSWN8W2V33ZY2B3RTEMM',1,'loss_aa',2.33854842185974121093e+00);
INSERT INTO "job_metrics" VALUES(5,'job_01M7YDBSWN8W2V33ZY2B3RTEMM',1,'grad_norm',2.05579476838282886323e+01);
INSERT INTO "job_metrics" VALUES(6,'job_01M7YDBSWN8W2V33ZY2B3RTEMM',1,'learning_rate',0.0005);
CREATE TABLE jobs (
    id text primary key,
    task_id text not null references tasks (id),
    kind text not null check (kind in ('pretrain', 'score', 'train', 'export')),
    spec text not null,              -- JSON of the domain's JobSpec, complete
    state text not null check (state in ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    priority integer not null,
    result_id text not null unique,  -- given at submission, so that later jobs can name it
    done integer not null default 0,
    total integer not null default 0,
    message text not null default '',
    error text not null default '',
    attempt integer not null default 0,
    max_attempts integer not null,
    cancel_requested integer not null default 0,
    token_hash text,                 -- BLAKE3 of the running attempt's token; null: no worker may speak for it
    checkpoint text,                 -- blob to resume from
    checkpoint_step integer,
    peak_memory_bytes integer not null default 0,
    created_at integer not null,
    started_at integer,
    ended_at integer
) strict;
INSERT INTO "jobs" VALUES('job_01M7YDBSWN8W2V33ZY2B3RTEMM','task_01M7YDBPV65VN7BAH0STQD3JXY','pretrain','{"kind":"pretrain","snapshot_id":"snap_01M7YDBSWN8W2V33ZY2B3RTEMJ","spec":{"model":{"preset":"tiny","segment_length":3},"objectives":["mtp","tr","aa"],"optim":{"steps":3,"batch":8,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":2,"clip_norm":1.0},"seed":7,"checkpoint_every":5,"device":"cpu","threads":null}}','succeeded',0,'enc_01M7YDBSWN8W2V33ZY2B3RTEMK',3,3,'done','',1,3,0,NULL,NULL,NULL,171159552,1795243239317,1795243239318,1795243239566);
INSERT INTO "jobs" VALUES('job_01M7YDBT4FWA0ZN3MTB8D0W7PT','task_01M7YDBPV65VN7BAH0STQD3JXY','train','{"kind":"train","encoder_id":"enc_01M7YDBSWN8W2V33ZY2B3RTEMK","snapshot_id":"snap_01M7YDBSWN8W2V33ZY2B3RTEMJ","dataset_id":null,"spec":{"policy":"finetune","optim":{"steps":3,"batch":8,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":2,"clip_norm":1.0},"lambda":0.1,"seed":7,"checkpoint_every":5,"device":"cpu","threads":null}}','succeeded',0,'pol_01M7YDBT4FWA0ZN3MTB8D0W7PS',3,3,'done','',1,3,0,NULL,NULL,NULL,169771008,1795243239567,1795243239651,1795243239880);
CREATE TABLE labels (
    id integer primary key,
    episode_id text not null references episodes (id),
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    author text not null,
    reason text not null,
    created_at integer not null
) strict;
INSERT INTO "labels" VALUES(1,'ep_01M7YDBQ4JW36Z4D9E30MMZ6D3','success','expert','tests','',1795243236499);
INSERT INTO "labels" VALUES(2,'ep_01M7YDBQCT1Z2Z0ZPS7MGXWRB4','success','expert','tests','',1795243236762);
INSERT INTO "labels" VALUES(3,'ep_01M7YDBQMWVKVHN3FNPEB0ZNH8','success','expert','tests','',1795243237020);
INSERT INTO "labels" VALUES(4,'ep_01M7YDBQWK7Y6YHCY73P3KBKJ4','success','expert','tests','',1795243237267);
INSERT INTO "labels" VALUES(5,'ep_01M7YDBR4D02KS3CA489GEX7BD','success','expert','tests','',1795243237517);
INSERT INTO "labels" VALUES(6,'ep_01M7YDBRC6QC6B0SWGSQH8NQNM','success','expert','tests','',1795243237767);
INSERT INTO "labels" VALUES(7,'ep_01M7YDBRMNH5QDWQSANSSS58QX','failure','failed','tests','',1795243238037);
INSERT INTO "labels" VALUES(8,'ep_01M7YDBRWNQYNRBP3Y89EEZ608','failure','failed','tests','',1795243238294);
INSERT INTO "labels" VALUES(9,'ep_01M7YDBS4HW2NECD25JAJVG6K0','failure','failed','tests','',1795243238545);
INSERT INTO "labels" VALUES(10,'ep_01M7YDBSCFGZQM50C9K9K9E6R5','failure','failed','tests','',1795243238799);
INSERT INTO "labels" VALUES(11,'ep_01M7YDBSMJSJNA6DB4SKYEF8ED','failure','failed','tests','',1795243239058);
INSERT INTO "labels" VALUES(12,'ep_01M7YDBSWK4RZ9S3BGTV7SKK3N','failure','failed','tests','',1795243239315);
CREATE TABLE policies (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    kind text not null,
    encoder_id text not null references encoders (id),
    dataset_id text references datasets (id),  -- null: experts alone
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;
INSERT INTO "policies" VALUES('pol_01M7YDBT4FWA0ZN3MTB8D0W7PS','task_01M7YDBPV65VN7BAH0STQD3JXY','job_01M7YDBT4FWA0ZN3MTB8D0W7PT','finetune','enc_01M7YDBSWN8W2V33ZY2B3RTEMK',NULL,'f3908280afbcc02d61ce156ee75bc3fd900ec6dae019c69ebc2b4cac00b0370c',1795243239880);
CREATE TABLE schedules (
    id text primary key,
    task_id text not null references tasks (id),
    name text not null,
    cron text,                       -- either this
    labelled_episodes integer,       -- or this
    pipeline text not null,          -- JSON of the domain's PipelineSpec
    paused integer not null default 0,
    next_run_at integer,             -- cron only
    last_run_at integer,
    label_mark integer not null default 0,  -- labels.id up to which labels have been counted
    last_error text not null default '',
    created_at integer not null,
    unique (task_id, name),
    check ((cron is null) <> (labelled_episodes is null))
) strict;
CREATE TABLE score_runs (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    encoder_id text not null references encoders (id),
    snapshot_id text not null references snapshots (id),
    similarity text not null,
    normaliser text not null,
    lo real not null,                -- frozen: later segments are clamped
    hi real not null,
    expert_ids text not null,        -- JSON list: what match_episode counts in
    created_at integer not null
) strict;
CREATE TABLE snapshot_episodes (
    snapshot_id text not null references snapshots (id),
    position integer not null,       -- keeps the order, which is part of what a job saw
    episode_id text not null references episodes (id),
    outcome text not null,           -- as labelled then
    cohort text not null,
    role text not null check (role in ('expert', 'imperfect')),
    primary key (snapshot_id, position),
    unique (snapshot_id, episode_id)
) strict, without rowid;
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',0,'ep_01M7YDBQ4JW36Z4D9E30MMZ6D3','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',1,'ep_01M7YDBQCT1Z2Z0ZPS7MGXWRB4','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',2,'ep_01M7YDBQMWVKVHN3FNPEB0ZNH8','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',3,'ep_01M7YDBQWK7Y6YHCY73P3KBKJ4','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',4,'ep_01M7YDBR4D02KS3CA489GEX7BD','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',5,'ep_01M7YDBRC6QC6B0SWGSQH8NQNM','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',6,'ep_01M7YDBRMNH5QDWQSANSSS58QX','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',7,'ep_01M7YDBRWNQYNRBP3Y89EEZ608','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',8,'ep_01M7YDBS4HW2NECD25JAJVG6K0','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',9,'ep_01M7YDBSCFGZQM50C9K9K9E6R5','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',10,'ep_01M7YDBSMJSJNA6DB4SKYEF8ED','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ',11,'ep_01M7YDBSWK4RZ9S3BGTV7SKK3N','failure','failed','imperfect');
CREATE TABLE snapshots (
    id text primary key,
    task_id text not null references tasks (id),
    rule text not null,              -- JSON of the domain's RoleRule
    created_at integer not null
) strict;
INSERT INTO "snapshots" VALUES('snap_01M7YDBSWN8W2V33ZY2B3RTEMJ','task_01M7YDBPV65VN7BAH0STQD3JXY','{"expert_cohorts":[],"imperfect_cohorts":[]}',1795243239317);
CREATE TABLE tasks (
    id text primary key,
    name text not null unique,
    spec text not null,              -- JSON of the recording crate's TaskSpec
    created_at integer not null      -- every time here is milliseconds since 1970, UTC
) strict;
INSERT INTO "tasks" VALUES('task_01M7YDBPV65VN7BAH0STQD3JXY','pick_cube','{"name":"pick_cube","rate_hz":10.0,"cameras":[{"name":"table","height":16,"width":16,"depth":true},{"name":"hand","height":16,"width":16,"depth":true}],"proprioception":[{"name":"tool_position","size":3},{"name":"tool_yaw","size":2},{"name":"gripper_width","size":1},{"name":"tool_velocity","size":3},{"name":"goal","size":3},{"name":"goal_from_tool","size":3}],"action":[{"name":"delta_position","size":3},{"name":"delta_rotation","size":3},{"name":"gripper","size":1}],"alignment":"latest_before","tolerance":0.25,"mappings":[{"name":"gleaner","cameras":[{"camera":"table","color":"/camera/table/color","depth":"/camera/table/depth"},{"camera":"hand","color":"/camera/hand/color","depth":"/camera/hand/depth"}],"fields":[{"field":"tool_position","topic":"/robot/state","paths":["tool_position"]},{"field":"tool_yaw","topic":"/robot/state","paths":["tool_yaw"]},{"field":"gripper_width","topic":"/robot/state","paths":["gripper_width"]},{"field":"tool_velocity","topic":"/robot/state","paths":["tool_velocity"]},{"field":"goal","topic":"/robot/state","paths":["goal"]},{"field":"goal_from_tool","topic":"/robot/state","paths":["goal_from_tool"]},{"field":"delta_position","topic":"/robot/action","paths":["delta_position"]},{"field":"delta_rotation","topic":"/robot/action","paths":["delta_rotation"]},{"field":"gripper","topic":"/robot/action","paths":["gripper"]}],"clock":"/robot/action"}]}',1795243236198);
CREATE TABLE uploads (
    id text primary key,
    task_id text not null references tasks (id),
    file_name text not null,
    size_bytes integer not null,
    blake3 text not null,
    committed integer not null default 0,
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    author text not null,
    created_at integer not null
) strict;
CREATE INDEX episodes_by_task on episodes (task_id, id);
CREATE INDEX labels_by_episode on labels (episode_id, id);
CREATE INDEX snapshots_by_task on snapshots (task_id, id);
CREATE INDEX jobs_queued on jobs (priority desc, id) where state = 'queued';
CREATE INDEX jobs_by_task on jobs (task_id, id);
CREATE INDEX job_dependents on job_dependencies (needs);
CREATE INDEX job_metrics_by_job on job_metrics (job_id, id);
CREATE INDEX score_runs_by_task on score_runs (task_id, id);
CREATE INDEX datasets_by_task on datasets (task_id, id);
CREATE INDEX policies_by_task on policies (task_id, id);
CREATE INDEX deployment_changes_by_name on deployment_changes (name, id);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('job_metrics',36);
COMMIT;
