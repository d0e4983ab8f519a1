-- A database of schema 24: twelve recordings and two encoders.
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
INSERT INTO "_sqlx_migrations" VALUES(1,'task','2026-11-23 01:20:52',1,X'FA71821A2BF611125622DE0E9B96895FFD5D2168576677FC0D31DC3B0EAFA2025267A853DBA4A1AE418BB9E4207AE9E1',1022874);
INSERT INTO "_sqlx_migrations" VALUES(2,'episode','2026-11-23 01:20:52',1,X'DDA2A2BFE2528395630EC934DAC4BF34EC1A4875F47120511D015664F76F10FE5033EF6675E513A179F6F8279845B527',1239813);
INSERT INTO "_sqlx_migrations" VALUES(3,'snapshot','2026-11-23 01:20:52',1,X'644FF300CDAA7D5E4FC4E0CDC456A5148252ED6D96394ABFCC35C2BBCD3B782D039BFBE532FBD0D9776474F1BE1D5781',1018103);
INSERT INTO "_sqlx_migrations" VALUES(4,'job','2026-11-23 01:20:52',1,X'8C62F6727570862D0E600862BBD5316F4990A5DFD169956574404A8D6B7C67FAE8A607BA154785859B59774737EAD80B',883967);
INSERT INTO "_sqlx_migrations" VALUES(5,'score','2026-11-23 01:20:52',1,X'0F93457A1FA1E05B3B6EE04A927918E463F67EF0391A60818DEC3E733D73B8AD6B790E7376EB676AB700A3D9B773A3CE',968192);
INSERT INTO "_sqlx_migrations" VALUES(6,'dataset','2026-11-23 01:20:52',1,X'DC03014775B5541BFF32449A3E8CAD79218635C048978F65A429EC580958B18B9C91FB5FDFB86C5E2C666C27629C3F14',1502733);
INSERT INTO "_sqlx_migrations" VALUES(7,'policy','2026-11-23 01:20:52',1,X'9E064267E96C53723CD0AE84AD4AF8459B23FB68DCE41A01AEC4A4096929332486AB255365BC401A104AC7FFB5C60AA5',1401673);
INSERT INTO "_sqlx_migrations" VALUES(8,'schedule','2026-11-23 01:20:52',1,X'F5B32CE001D764DE5B04B0822E8BD955E14A79C25EB17282C143C7EA6ABC5556D41E740CF0C5786EAF7874292F47D00C',715905);
INSERT INTO "_sqlx_migrations" VALUES(9,'evaluation','2026-11-23 01:20:52',1,X'1630AF32CE36C6535468361A2AF7F16E4EF9378A2B9A90B701C902FE350C7D6688E2F9994BE129F38EDC707BE8085FC8',654608);
INSERT INTO "_sqlx_migrations" VALUES(10,'job key','2026-11-23 01:20:52',1,X'56BBAB30C98C4F70FD66657F35E9ECA6F56D9315B125469E1BB36F8DFD3BB177B17503A729BBA8EE1CFEAABEA41FA7F4',1566826);
INSERT INTO "_sqlx_migrations" VALUES(11,'selection','2026-11-23 01:20:52',1,X'74F493C23AEF40874D3BEE6B291DB6714BBDCAC59AEE4E39F526423FE391B1FA684D16F8EFA59D1598E66F53534F0641',2025525);
INSERT INTO "_sqlx_migrations" VALUES(12,'score settings','2026-11-23 01:20:52',1,X'CFA8032E482D0ED1912136D3147E7B8F261DBA53C164F6970FAB2D50D79E9E218DFF424B025604F0E1ED9C4F666D3213',2121081);
INSERT INTO "_sqlx_migrations" VALUES(13,'policy from scratch','2026-11-23 01:20:52',1,X'C7FA05915060DC451181499AEF02BBEC2A9D49CDD67065B825225BF9B14053AFB311B1B114264E40B6767909B491DAFA',952415);
INSERT INTO "_sqlx_migrations" VALUES(14,'score measure','2026-11-23 01:20:52',1,X'4A9D39933BADC93203577219C0F5274522C4642311187E2E81409D14DEB400FE9A1A723A102B1DE9839F006FFF83FBC6',1701074);
INSERT INTO "_sqlx_migrations" VALUES(15,'deployment rollback','2026-11-23 01:20:52',1,X'8E856109DA79819E36FB7A22BC3A9CCAC85357FBA61604728A71932ED5F9D30FAD8E8738C73119F596592E148C40C4C4',1641384);
INSERT INTO "_sqlx_migrations" VALUES(16,'history dropout','2026-11-23 01:20:52',1,X'071BD251D5EC51A0C827559F4489BCA8CF288659EFC370E916F8191225E0D55DD28A883F7D54A63BA2529A837266515F',827569);
INSERT INTO "_sqlx_migrations" VALUES(17,'deployment score run','2026-11-23 01:20:52',1,X'89830E0690465025461BFCA7534C244332F67CD77CB7CA8247C974C06381F4D5BCAE8F134712C7D3DF37002D72944F27',1516427);
INSERT INTO "_sqlx_migrations" VALUES(18,'token','2026-11-23 01:20:52',1,X'79532350818563457CBA1BA8E5E22C6BD69F3FB6755BE6462B408B3B168B446FDB87F6BE2F83531496AB30297702BDC6',1425900);
INSERT INTO "_sqlx_migrations" VALUES(19,'audit','2026-11-23 01:20:52',1,X'938A14F28667CC0B0E9B4D22B4014885C26D4EA34DCE46090BF59D9F44F7C122F3775EE5F9CF55464091FD0381507721',1012757);
INSERT INTO "_sqlx_migrations" VALUES(20,'episode trash','2026-11-23 01:20:52',1,X'848DEDA5B8B82523DCCF6BC4F31B0F9ADAD574F21734D4F0F45B62469C8C8F97D486F3FB5A6E90E7F049D54FE83D84E2',2034568);
INSERT INTO "_sqlx_migrations" VALUES(21,'lab','2026-11-23 01:20:52',1,X'41FBEB238206BB18E4905EA3887B58FAAE30FA2DB22A361CEC443D820AB803D637EFE295768623534E5565985E4274DA',1895735);
INSERT INTO "_sqlx_migrations" VALUES(22,'upload caller','2026-11-23 01:20:52',1,X'30FB244C463D2C7EFA9AA1B68295C6E2987E50FDB1D289F8910AF13499A93D0BF7B74A72DBFA6F6886397F6E49BC7C55',1495157);
INSERT INTO "_sqlx_migrations" VALUES(23,'overview index','2026-11-23 01:20:52',1,X'C03D66FF91ACE86A5F0E386201C5F1BA1019DEE49402B37BD909B13F661E506ECCEDA0EAB468C68685728F5569D8C0BA',1434512);
INSERT INTO "_sqlx_migrations" VALUES(24,'settings','2026-11-23 01:20:52',1,X'EDFEDE17EC9BAFC34087A10F4F1CE5CDA642A63F20511A6421A6D5101AE8DF505B8E6E52F4C7D839CDA731D9EC77DB4A',8764724);
CREATE TABLE audit (
    id integer primary key,
    at integer not null,
    token_id text,                   -- null: nobody was asked for one
    who text not null,               -- the token's name, or where the caller sits
    peer text not null,              -- the caller's address; empty when unknown
    rpc text not null,
    subjects text not null,          -- JSON list of field=value
    outcome text not null            -- ok, or the status it was refused with
) strict;
INSERT INTO "audit" VALUES(1,1795396852415,NULL,'anyone','127.0.0.1:48528','TaskService/CreateTask','["spec.name=pick_cube","task.id=task_01M82ZVPNV67759K2VYY67TTRT","task.spec.name=pick_cube"]','ok');
CREATE TABLE clock_jumps (
    elapsed_ms integer not null,           -- `lab.elapsed_ms` at the jump
    jump_ms integer not null
) strict;
CREATE TABLE datasets (
    id text primary key,
    task_id text not null references tasks (id),
    score_run_id text not null references jobs (result_id),
    beta real check (beta between 0 and 1),                              -- either this
    top_fraction real check (top_fraction > 0 and top_fraction <= 1),    -- or this
    created_at integer not null,
    check ((beta is null) <> (top_fraction is null))
) strict;
CREATE TABLE deployment_changes (
    id integer primary key,
    name text not null references deployments (name),
    policy_id text not null references policies (id),
    created_at integer not null
, previous integer references deployment_changes (id), score_run_id text references score_runs (id)) strict;
CREATE TABLE deployments (
    name text primary key,
    task_id text not null references tasks (id)
) strict;
CREATE TABLE encoders (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    snapshot_id text not null references snapshots (id),
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;
INSERT INTO "encoders" VALUES('enc_01M82ZVQGSXRDDSQ7M7KGRBF8A','task_01M82ZVPNV67759K2VYY67TTRT','job_01M82ZVQGSXRDDSQ7M7KGRBF8B','snap_01M82ZVQGQHXC8EPH3RFPTM9AX','34dac72cb96237525a54ca97280010e9998278ffe9c132ade7fbfd0245fba47c',1795396857946);
INSERT INTO "encoders" VALUES('enc_01M82ZVWZ3X2BC8JZAW9E7AE9C','task_01M82ZVPNV67759K2VYY67TTRT','job_01M82ZVWZ3X2BC8JZAW9E7AE9D','snap_01M82ZVWZ2AC4BH0372X8WWFKB','34dac72cb96237525a54ca97280010e9998278ffe9c132ade7fbfd0245fba47c',1795396865487);
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
    created_at integer not null, deleted_at integer, delete_forced integer not null default 0, purged_at integer,
    unique (task_id, recording)      -- the same content twice is the same episode
) strict;
INSERT INTO "episodes" VALUES('ep_01M82ZVPT461EXYPZSHJ72FK0V','task_01M82ZVPNV67759K2VYY67TTRT','0001.mcap','50d9eba328aa9c2c3dbea193ac9029a616cea8bc358f43a39583e80befc29813',24890,23,2.2,'gleaner',0,'{"mapping":"gleaner","messages":138,"steps":23,"duration_ns":2200000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":23,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":23,"used":true}],"findings":[]}','success','expert',1795396852548,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVPW48J2295AEGNEVRQQA','task_01M82ZVPNV67759K2VYY67TTRT','0002.mcap','9b84f08604e82ec2d463b1d05eb9fb432bcb0bf057d8a16304e7e1d49804a5c0',22497,21,2.0,'gleaner',0,'{"mapping":"gleaner","messages":126,"steps":21,"duration_ns":2000000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":21,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":21,"used":true}],"findings":[]}','success','expert',1795396852613,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVPYMVXXAJAAQ8CTVTMNC','task_01M82ZVPNV67759K2VYY67TTRT','0003.mcap','c388b19dcbf5e065fbd48624ee63fa3df9f7d7ac456f6bad79577148233b19b3',28513,28,2.7,'gleaner',0,'{"mapping":"gleaner","messages":168,"steps":28,"duration_ns":2700000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":28,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":28,"used":true}],"findings":[]}','success','expert',1795396852692,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQ10B7TDXFDW8HJQPMPA','task_01M82ZVPNV67759K2VYY67TTRT','0004.mcap','26f3249683c95bbbb14111f4ec53e8edaf039b68c0dbab91697f2506e9c8c2fc',25939,26,2.5,'gleaner',0,'{"mapping":"gleaner","messages":156,"steps":26,"duration_ns":2500000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":26,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":26,"used":true}],"findings":[]}','success','expert',1795396852768,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQ3TXQ2G6PHPMGH6YW7E','task_01M82ZVPNV67759K2VYY67TTRT','0005.mcap','5ab2922bc18ed8aeb0d41ad0195b3d900d4e4783e1468260405f2bf2f2879e91',27673,27,2.6,'gleaner',0,'{"mapping":"gleaner","messages":162,"steps":27,"duration_ns":2600000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":27,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":27,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":27,"used":true}],"findings":[]}','success','expert',1795396852858,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQ5X8DTEAQY4MTR6MZ5Y','task_01M82ZVPNV67759K2VYY67TTRT','0006.mcap','623b645e16bdb37f1f0a8e69acaeb2242c7cc881cb0adc1606909b751584bfb6',23614,22,2.1,'gleaner',0,'{"mapping":"gleaner","messages":132,"steps":22,"duration_ns":2100000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":22,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":22,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":22,"used":true}],"findings":[]}','success','expert',1795396852925,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQ7JVNP36MWFWY5CBVGA','task_01M82ZVPNV67759K2VYY67TTRT','0007.mcap','d66d8a4f76d123069bf958c39b1ca32f5cf18baa5ac9ac169ae85e5ffdcebb0a',48751,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795396852978,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQ9QBXQ5SJD1YNAE91J0','task_01M82ZVPNV67759K2VYY67TTRT','0008.mcap','197d573d422c5bae9385e9187b49e2b65ad90a5c572e526023ce3b16fdf46557',47195,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795396853047,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQB32RR6MV56RB86F6VK','task_01M82ZVPNV67759K2VYY67TTRT','0009.mcap','aac98799bf76479a4b8c7c0eebd116036b75a76e581f73477096261c0ff1adf1',45246,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795396853091,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQCPQX3DJ00N3SCTJCSS','task_01M82ZVPNV67759K2VYY67TTRT','0010.mcap','0873722aea7103c34c9895ebaca63c2c13508a7bfb5b19b5dd31a9631bca8d58',53582,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795396853142,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQEK1NBY9BJPD0C8CD4W','task_01M82ZVPNV67759K2VYY67TTRT','0011.mcap','5bcac3cb49a0ccdb2d2e6df87ddd2e5ca85d5a91d42b99fa8824807c160d1c26',50739,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795396853203,NULL,0,NULL);
INSERT INTO "episodes" VALUES('ep_01M82ZVQG30M81H09B8DQDQVGQ','task_01M82ZVPNV67759K2VYY67TTRT','0012.mcap','aa95b59f9aa3c46918d386862a6d6f798f2b3c45548e0d7a812ffdb2d0c13525',51559,60,5.9,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','failed',1795396853251,NULL,0,NULL);
CREATE TABLE evaluations (
    id text primary key,
    policy_id text not null references policies (id),
    job_id text references jobs (id),          -- null: reported from outside
    simulation text not null,
    seeds text not null,                       -- JSON list of the domain's SeedResult
    created_at integer not null
) strict;
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
CREATE TABLE job_metrics (
    -- The order of arrival, where `watch` goes on; never used again when a resumed job's metrics are cut back.
    id integer primary key autoincrement,
    job_id text not null references jobs (id),
    step integer not null,
    name text not null,
    value real not null
) strict;
INSERT INTO "job_metrics" VALUES(1,'job_01M82ZVQGSXRDDSQ7M7KGRBF8B',1,'loss',3.75968217849731445312e+00);
INSERT INTO "job_metrics" VALUES(2,'job_01M82ZVQGSXRDDSQ7M7KGRBF8B',1,'loss_mtp',1.17863833904266357421e+00);
INSERT INTO "job_metrics" VALUES(3,'job_01M82ZVQGSXRDDSQ7M7KGRBF8B',1,'loss_tr',1.47840416431427);
INSERT INTO "job_metrics" VALUES(4,'job_01M82ZVQGSXRDDSQ7M7KGRBF8B',1,'loss_aa',1.10263967514038085937e+00);
INSERT INTO "job_metrics" VALUES(5,'job_01M82ZVQGSXRDDSQ7M7KGRBF8B',1,'grad_norm',1.2563135221639882388e+01);
INSERT INTO "job_metrics" VALUES(6,'job_01M82ZVQGSXRDDSQ7M7KGRBF8B',1,'learning_rate',0.0005);
CREATE TABLE jobs (
    id text primary key,
    task_id text not null references tasks (id),
    kind text not null check (kind in ('pretrain', 'score', 'train', 'export', 'evaluate')),
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
    ended_at integer,
    key text not null default '',    -- the caller's name for this work, or empty
    ordered text not null default '' -- JSON of the domain's JobOrder that came with the key
) strict;
INSERT INTO "jobs" VALUES('job_01M82ZVQGSXRDDSQ7M7KGRBF8B','task_01M82ZVPNV67759K2VYY67TTRT','pretrain','{"kind":"pretrain","snapshot_id":"snap_01M82ZVQGQHXC8EPH3RFPTM9AX","spec":{"batch":8,"brightness":0.0,"checkpoint_every":4,"clip_norm":1.0,"contrast":0.0,"device":"cpu","learning_rate":0.001,"objectives":["mtp","tr","aa"],"preset":"tiny","seed":7,"segment_length":3,"shift_pixels":0,"steps":76,"stretch":8,"warmup_steps":2,"weight_decay":0.01}}','succeeded',0,'enc_01M82ZVQGSXRDDSQ7M7KGRBF8A',76,76,'done','',1,3,0,NULL,NULL,NULL,192577536,1795396853274,1795396853278,1795396857951,'','');
INSERT INTO "jobs" VALUES('job_01M82ZVWZ3X2BC8JZAW9E7AE9D','task_01M82ZVPNV67759K2VYY67TTRT','pretrain','{"kind":"pretrain","snapshot_id":"snap_01M82ZVWZ2AC4BH0372X8WWFKB","spec":{"batch":8,"brightness":0.0,"checkpoint_every":4,"clip_norm":1.0,"contrast":0.0,"device":"cpu","learning_rate":0.001,"objectives":["mtp","tr","aa"],"preset":"tiny","seed":7,"segment_length":3,"shift_pixels":0,"steps":76,"stretch":8,"warmup_steps":2,"weight_decay":0.01}}','succeeded',0,'enc_01M82ZVWZ3X2BC8JZAW9E7AE9C',76,76,'done','',1,90,0,NULL,NULL,NULL,194465792,1795396858853,1795396858859,1795396865488,'','');
CREATE TABLE lab (
    id integer primary key check (id = 1),
    folder text not null,                  -- random name of the folder
    stamped integer not null default 0,    -- 1: the stamp was written, so a folder without one is another folder
    generation integer not null default 0,
    episodes integer not null default 0,   -- rows of `episodes`; another number there is a mixture of two copies
    elapsed_ms integer not null default 0, -- time that this database has seen pass, jumps of the clock left out
    seen_at integer                        -- the clock when that was looked at last
) strict;
INSERT INTO "lab" VALUES(1,'dbb34490125149a568aa8c6920984bbc',1,16,12,3606472,1795400458868);
CREATE TABLE labels (
    id integer primary key,
    episode_id text not null references episodes (id),
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    author text not null,
    reason text not null,
    created_at integer not null
) strict;
INSERT INTO "labels" VALUES(1,'ep_01M82ZVPT461EXYPZSHJ72FK0V','success','expert','tests','',1795396852571);
INSERT INTO "labels" VALUES(2,'ep_01M82ZVPW48J2295AEGNEVRQQA','success','expert','tests','',1795396852618);
INSERT INTO "labels" VALUES(3,'ep_01M82ZVPYMVXXAJAAQ8CTVTMNC','success','expert','tests','',1795396852697);
INSERT INTO "labels" VALUES(4,'ep_01M82ZVQ10B7TDXFDW8HJQPMPA','success','expert','tests','',1795396852775);
INSERT INTO "labels" VALUES(5,'ep_01M82ZVQ3TXQ2G6PHPMGH6YW7E','success','expert','tests','',1795396852861);
INSERT INTO "labels" VALUES(6,'ep_01M82ZVQ5X8DTEAQY4MTR6MZ5Y','success','expert','tests','',1795396852927);
INSERT INTO "labels" VALUES(7,'ep_01M82ZVQ7JVNP36MWFWY5CBVGA','failure','failed','tests','',1795396852982);
INSERT INTO "labels" VALUES(8,'ep_01M82ZVQ9QBXQ5SJD1YNAE91J0','failure','failed','tests','',1795396853055);
INSERT INTO "labels" VALUES(9,'ep_01M82ZVQB32RR6MV56RB86F6VK','failure','failed','tests','',1795396853093);
INSERT INTO "labels" VALUES(10,'ep_01M82ZVQCPQX3DJ00N3SCTJCSS','failure','failed','tests','',1795396853151);
INSERT INTO "labels" VALUES(11,'ep_01M82ZVQEK1NBY9BJPD0C8CD4W','failure','failed','tests','',1795396853205);
INSERT INTO "labels" VALUES(12,'ep_01M82ZVQG30M81H09B8DQDQVGQ','failure','failed','tests','',1795396853256);
CREATE TABLE policies (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    kind text not null,
    encoder_id text references encoders (id),  -- null: from scratch
    dataset_id text references datasets (id),  -- null: experts alone
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;
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
    lo real not null,                -- frozen: later segments are clamped
    hi real not null,
    expert_ids text not null,        -- JSON list: what match_episode counts in
    created_at integer not null
, extends text references score_runs (id), quantiles blob not null default x'', settings text not null default '{}') strict;
CREATE TABLE sidecar_queue (
    seq integer primary key autoincrement, -- another one at each change: what is written is taken out by it
    id text not null unique                -- of a task, an episode, an encoder or a policy
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
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',0,'ep_01M82ZVQCPQX3DJ00N3SCTJCSS','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',1,'ep_01M82ZVQ9QBXQ5SJD1YNAE91J0','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',2,'ep_01M82ZVQ10B7TDXFDW8HJQPMPA','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',3,'ep_01M82ZVPT461EXYPZSHJ72FK0V','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',4,'ep_01M82ZVQ3TXQ2G6PHPMGH6YW7E','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',5,'ep_01M82ZVQEK1NBY9BJPD0C8CD4W','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',6,'ep_01M82ZVQ5X8DTEAQY4MTR6MZ5Y','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',7,'ep_01M82ZVPW48J2295AEGNEVRQQA','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',8,'ep_01M82ZVQG30M81H09B8DQDQVGQ','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',9,'ep_01M82ZVQB32RR6MV56RB86F6VK','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',10,'ep_01M82ZVPYMVXXAJAAQ8CTVTMNC','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX',11,'ep_01M82ZVQ7JVNP36MWFWY5CBVGA','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',0,'ep_01M82ZVQCPQX3DJ00N3SCTJCSS','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',1,'ep_01M82ZVQ9QBXQ5SJD1YNAE91J0','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',2,'ep_01M82ZVQ10B7TDXFDW8HJQPMPA','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',3,'ep_01M82ZVPT461EXYPZSHJ72FK0V','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',4,'ep_01M82ZVQ3TXQ2G6PHPMGH6YW7E','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',5,'ep_01M82ZVQEK1NBY9BJPD0C8CD4W','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',6,'ep_01M82ZVQ5X8DTEAQY4MTR6MZ5Y','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',7,'ep_01M82ZVPW48J2295AEGNEVRQQA','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',8,'ep_01M82ZVQG30M81H09B8DQDQVGQ','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',9,'ep_01M82ZVQB32RR6MV56RB86F6VK','failure','failed','imperfect');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',10,'ep_01M82ZVPYMVXXAJAAQ8CTVTMNC','success','expert','expert');
INSERT INTO "snapshot_episodes" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB',11,'ep_01M82ZVQ7JVNP36MWFWY5CBVGA','failure','failed','imperfect');
CREATE TABLE snapshots (
    id text primary key,
    task_id text not null references tasks (id),
    rule text not null,              -- JSON of the domain's RoleRule
    created_at integer not null
) strict;
INSERT INTO "snapshots" VALUES('snap_01M82ZVQGQHXC8EPH3RFPTM9AX','task_01M82ZVPNV67759K2VYY67TTRT','{"expert_cohorts":[],"imperfect_cohorts":[],"imperfect_per_expert":0.0,"max_experts":0,"seed":0}',1795396853271);
INSERT INTO "snapshots" VALUES('snap_01M82ZVWZ2AC4BH0372X8WWFKB','task_01M82ZVPNV67759K2VYY67TTRT','{"expert_cohorts":[],"imperfect_cohorts":[],"imperfect_per_expert":0.0,"max_experts":0,"seed":0}',1795396858850);
CREATE TABLE tasks (
    id text primary key,
    name text not null unique,
    spec text not null,              -- JSON of the recording crate's TaskSpec
    created_at integer not null      -- every time here is milliseconds since 1970, UTC
) strict;
INSERT INTO "tasks" VALUES('task_01M82ZVPNV67759K2VYY67TTRT','pick_cube','{"name":"pick_cube","rate_hz":10.0,"cameras":[{"name":"table","height":16,"width":16,"depth":true},{"name":"hand","height":16,"width":16,"depth":true}],"proprioception":[{"name":"tool_position","size":3},{"name":"tool_yaw","size":2},{"name":"gripper_width","size":1},{"name":"tool_velocity","size":3},{"name":"goal","size":3},{"name":"goal_from_tool","size":3}],"action":[{"name":"delta_position","size":3},{"name":"delta_rotation","size":3},{"name":"gripper","size":1}],"alignment":"latest_before","tolerance":0.25,"mappings":[{"name":"gleaner","cameras":[{"camera":"table","color":"/camera/table/color","depth":"/camera/table/depth"},{"camera":"hand","color":"/camera/hand/color","depth":"/camera/hand/depth"}],"fields":[{"field":"tool_position","topic":"/robot/state","paths":["tool_position"]},{"field":"tool_yaw","topic":"/robot/state","paths":["tool_yaw"]},{"field":"gripper_width","topic":"/robot/state","paths":["gripper_width"]},{"field":"tool_velocity","topic":"/robot/state","paths":["tool_velocity"]},{"field":"goal","topic":"/robot/state","paths":["goal"]},{"field":"goal_from_tool","topic":"/robot/state","paths":["goal_from_tool"]},{"field":"delta_position","topic":"/robot/action","paths":["delta_position"]},{"field":"delta_rotation","topic":"/robot/action","paths":["delta_rotation"]},{"field":"gripper","topic":"/robot/action","paths":["gripper"]}],"clock":"/robot/action"}]}',1795396852411);
CREATE TABLE tokens (
    id text primary key,
    name text not null,
    role text not null,
    deployments text not null,       -- JSON list; a robot's, empty for other roles
    hash text not null unique,       -- BLAKE3 of the token
    created_at integer not null,
    expires_at integer,              -- null: never
    revoked_at integer,
    last_used_at integer             -- to the minute
) strict;
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
, client text not null default 'server') strict;
CREATE INDEX episodes_by_task on episodes (task_id, id);
CREATE INDEX labels_by_episode on labels (episode_id, id);
CREATE INDEX snapshots_by_task on snapshots (task_id, id);
CREATE INDEX job_dependents on job_dependencies (needs);
CREATE INDEX job_metrics_by_job on job_metrics (job_id, id);
CREATE INDEX score_runs_by_task on score_runs (task_id, id);
CREATE INDEX deployment_changes_by_name on deployment_changes (name, id);
CREATE INDEX evaluations_by_policy on evaluations (policy_id, id);
CREATE INDEX jobs_queued on jobs (priority desc, id) where state = 'queued';
CREATE INDEX jobs_by_task on jobs (task_id, id);
CREATE UNIQUE INDEX jobs_by_key on jobs (task_id, key) where key <> '' and state not in ('failed', 'cancelled');
CREATE INDEX datasets_by_task on datasets (task_id, id);
CREATE INDEX datasets_by_run on datasets (score_run_id);
CREATE INDEX policies_by_task on policies (task_id, id);
CREATE UNIQUE INDEX tokens_by_name on tokens (name) where revoked_at is null and name <> '';
CREATE INDEX audit_by_time on audit (at, id);
CREATE INDEX episodes_in_trash on episodes (deleted_at) where deleted_at is not null;
CREATE INDEX episodes_by_recording on episodes (recording);
CREATE INDEX snapshots_of_episode on snapshot_episodes (episode_id);
CREATE INDEX scores_of_episode on episode_scores (episode_id);
CREATE TRIGGER episode_counted after insert on episodes begin
    update lab set episodes = episodes + 1;
end;
CREATE TRIGGER episode_uncounted after delete on episodes begin
    update lab set episodes = episodes - 1;
end;
CREATE TRIGGER task_described after insert on tasks begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
CREATE TRIGGER episode_described after insert on episodes begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
CREATE TRIGGER episode_changed after update of outcome, cohort, deleted_at, purged_at on episodes begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
CREATE TRIGGER encoder_described after insert on encoders begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
CREATE TRIGGER policy_described after insert on policies begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
CREATE INDEX uploads_by_client on uploads (client);
CREATE INDEX episodes_at_a_glance on episodes (task_id, deleted_at, outcome, cohort, duration_s, size_bytes);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('sidecar_queue',15);
INSERT INTO "sqlite_sequence" VALUES('job_metrics',1064);
COMMIT;
