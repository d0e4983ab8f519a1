-- A database of schema 20: that of schema 17 brought up to it, with an episode in the trash and an entry of the audit log.
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
INSERT INTO _sqlx_migrations VALUES(1,'task','2026-11-21 15:24:56',1,X'fa71821a2bf611125622de0e9b96895ffd5d2168576677fc0d31dc3b0eafa2025267a853dba4a1ae418bb9e4207ae9e1',3046663);
INSERT INTO _sqlx_migrations VALUES(2,'episode','2026-11-21 15:24:56',1,X'dda2a2bfe2528395630ec934dac4bf34ec1a4875f47120511d015664f76f10fe5033ef6675e513a179f6f8279845b527',3176696);
INSERT INTO _sqlx_migrations VALUES(3,'snapshot','2026-11-21 15:24:56',1,X'644ff300cdaa7d5e4fc4e0cdc456a5148252ed6d96394abfcc35c2bbcd3b782d039bfbe532fbd0d9776474f1be1d5781',3188994);
INSERT INTO _sqlx_migrations VALUES(4,'job','2026-11-21 15:24:56',1,X'8c62f6727570862d0e600862bbd5316f4990a5dfd169956574404a8d6b7c67fae8a607ba154785859b59774737ead80b',3972277);
INSERT INTO _sqlx_migrations VALUES(5,'score','2026-11-21 15:24:56',1,X'0f93457a1fa1e05b3b6ee04a927918e463f67ef0391a60818dec3e733d73b8ad6b790e7376eb676ab700a3d9b773a3ce',732067);
INSERT INTO _sqlx_migrations VALUES(6,'dataset','2026-11-21 15:24:56',1,X'dc03014775b5541bff32449a3e8cad79218635c048978f65a429ec580958b18b9c91fb5fdfb86c5e2c666c27629c3f14',1585724);
INSERT INTO _sqlx_migrations VALUES(7,'policy','2026-11-21 15:24:56',1,X'9e064267e96c53723cd0ae84ad4af8459b23fb68dce41a01aec4a4096929332486ab255365bc401a104ac7ffb5c60aa5',607301);
INSERT INTO _sqlx_migrations VALUES(8,'schedule','2026-11-21 15:24:56',1,X'f5b32ce001d764de5b04b0822e8bd955e14a79c25eb17282c143c7ea6abc5556d41e740cf0c5786eaf7874292f47d00c',562925);
INSERT INTO _sqlx_migrations VALUES(9,'evaluation','2026-11-21 15:24:56',1,X'1630af32ce36c6535468361a2af7f16e4ef9378a2b9a90b701c902fe350c7d6688e2f9994be129f38edc707be8085fc8',690445);
INSERT INTO _sqlx_migrations VALUES(10,'job key','2026-11-21 15:24:56',1,X'56bbab30c98c4f70fd66657f35e9eca6f56d9315b125469e1bb36f8dfd3bb177b17503a729bba8ee1cfeaabea41fa7f4',5216916);
INSERT INTO _sqlx_migrations VALUES(11,'selection','2026-11-21 15:24:56',1,X'74f493c23aef40874d3bee6b291db6714bbdcac59aee4e39f526423fe391b1fa684d16f8efa59d1598e66f53534f0641',3965898);
INSERT INTO _sqlx_migrations VALUES(12,'score settings','2026-11-21 15:24:56',1,X'cfa8032e482d0ed1912136d3147e7b8f261dba53c164f6970fab2d50d79e9e218dff424b025604f0e1ed9c4f666d3213',3844508);
INSERT INTO _sqlx_migrations VALUES(13,'policy from scratch','2026-11-21 15:24:56',1,X'c7fa05915060dc451181499aef02bbec2a9d49cdd67065b825225bf9b14053afb311b1b114264e40b6767909b491dafa',3979578);
INSERT INTO _sqlx_migrations VALUES(14,'score measure','2026-11-21 15:24:56',1,X'4a9d39933badc93203577219c0f5274522c4642311187e2e81409d14deb400fe9a1a723a102b1de9839f006fff83fbc6',1030891);
INSERT INTO _sqlx_migrations VALUES(15,'deployment rollback','2026-11-21 15:24:56',1,X'8e856109da79819e36fb7a22bc3a9ccac85357fba61604728a71932ed5f9d30fad8e8738c73119f596592e148c40c4c4',1060074);
INSERT INTO _sqlx_migrations VALUES(16,'history dropout','2026-11-21 15:24:56',1,X'071bd251d5ec51a0c827559f4489bca8cf288659efc370e916f8191225e0d55dd28a883f7d54a63ba2529a837266515f',582085);
INSERT INTO _sqlx_migrations VALUES(17,'deployment score run','2026-11-21 15:24:56',1,X'89830e0690465025461bfca7534c244332f67cd77cb7ca8247c974c06381f4d5bcae8f134712c7d3df37002d72944f27',712989);
INSERT INTO _sqlx_migrations VALUES(18,'token','2026-11-22 15:24:56',1,X'79532350818563457cba1ba8e5e22c6bd69f3fb6755be6462b408b3b168b446fdb87f6be2f83531496ab30297702bdc6',600000);
INSERT INTO _sqlx_migrations VALUES(19,'audit','2026-11-22 15:24:56',1,X'938a14f28667cc0b0e9b4d22b4014885c26d4ea34dce46090bf59d9f44f7c122f3775ee5f9cf55464091fd0381507721',600000);
INSERT INTO _sqlx_migrations VALUES(20,'episode trash','2026-11-22 15:24:56',1,X'848deda5b8b82523dccf6bc4f31b0f9adad574f21734d4f0f45b62469c8c8f97d486f3fb5a6e90e7f049d54fe83d84e2',600000);
CREATE TABLE datasets (
    id text primary key,
    task_id text not null references tasks (id),
    score_run_id text not null references jobs (result_id),
    beta real check (beta between 0 and 1),                              -- either this
    top_fraction real check (top_fraction > 0 and top_fraction <= 1),    -- or this
    created_at integer not null,
    check ((beta is null) <> (top_fraction is null))
) strict;
INSERT INTO datasets VALUES('ds_01M7ZBBYW3RXT2S0Z5EZTDAS1G','task_01M7ZBBSHEDMXH49VZST4HGV4W','run_01M7ZBBXHFXTAZZ6H72XEAGWT3',NULL,0.5,1795274701699);
CREATE TABLE deployment_changes (
    id integer primary key,
    name text not null references deployments (name),
    policy_id text not null references policies (id),
    created_at integer not null
, previous integer references deployment_changes (id), score_run_id text references score_runs (id)) strict;
INSERT INTO deployment_changes VALUES(1,'pick_small@test','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',1795274701694,NULL,NULL);
INSERT INTO deployment_changes VALUES(2,'second','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',1795274701852,NULL,NULL);
INSERT INTO deployment_changes VALUES(3,'rolled','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',1795274702191,NULL,NULL);
INSERT INTO deployment_changes VALUES(4,'rolled','pol_01M7ZBBZ136F54N8W0RRNW9N5T',1795274702203,3,NULL);
INSERT INTO deployment_changes VALUES(5,'rolled','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',1795274702216,NULL,NULL);
INSERT INTO deployment_changes VALUES(6,'pick_small@watched','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',1795274705412,NULL,'run_01M7ZBBXHFXTAZZ6H72XEAGWT3');
CREATE TABLE deployments (
    name text primary key,
    task_id text not null references tasks (id)
) strict;
INSERT INTO deployments VALUES('pick_small@test','task_01M7ZBBSHEDMXH49VZST4HGV4W');
INSERT INTO deployments VALUES('second','task_01M7ZBBSHEDMXH49VZST4HGV4W');
INSERT INTO deployments VALUES('rolled','task_01M7ZBBSHEDMXH49VZST4HGV4W');
INSERT INTO deployments VALUES('pick_small@watched','task_01M7ZBBSHEDMXH49VZST4HGV4W');
CREATE TABLE encoders (
    id text primary key,
    task_id text not null references tasks (id),
    job_id text not null references jobs (id),
    snapshot_id text not null references snapshots (id),
    checkpoint text not null,        -- blob
    created_at integer not null
) strict;
INSERT INTO encoders VALUES('enc_01M7ZBBXH9XMVV35ET6Q38RN2P','task_01M7ZBBSHEDMXH49VZST4HGV4W','job_01M7ZBBXH9XMVV35ET6Q38RN2Q','snap_01M7ZBBXH88HHJXQJSB8KM952T','3a4d59cab8ebc172a328b6474c490aa6b273be94831e95c15cafa88f5f387f3c',1795274700673);
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
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',0,'ep_01M7ZBBVE2Z3BT14CB44SS1WK7','expert',X'cb41884bb45c3ac0e13c3a30c9bf37c043738dc8a49836c0a6f4e4b689c636c0063a6900b44635c0eb36e4be4aab36c012583d1d370937c01a27b2deff5a36c09478a21a37d636c04544afb6ecb736c0395083ad3ec539c0f0b983d8094f3ac0de938698f4253dc0d20ac27eb3ee3bc010d1f11da0b939c03641c682d46a39c0a22a47d0917c39c0be7b7a11cfb337c0ca5603101bfb37c06d5ffa98066c38c096829582356839c03e0c1da17ee339c01f33315411033cc0b917412d5efb3cc0a885279f111640c02c95b8c263103ec0',X'7ff9db3e200a243f5eba3a3feea6423f98675f3f8fc3433f541a3b3f9622483fdfcb413fe621413f1e030e3fee82053f277f653e74e2a73e1f69fe3ec7f3023fc65f003fc6ad203fcf251b3f3463123f2a19013f8152ff3e64d98f3e7e35523e794d213eae1f9e3e',X'0100000001000000010000000100000001000000010000000100000001000000020000000100000001000000010000000300000002000000020000000200000002000000020000000200000002000000030000000100000003000000030000000100000001000000',X'02000000030000000300000004000000040000000500000006000000080000000500000008000000090000000a000000130000000d0000000d000000100000000e0000000f0000000f0000000f000000140000001100000016000000160000001500000015000000',X'8c7a3141f1482141910fa640d0101941aef8de40d9dee640bcd6094113fbf4400f6cca4030760f416baff0406c35c940003300411aeeea406782bd404b55f5409b94ee40717ff140220bda40c20602411f8701413760f1407eef0241c920d440cd6efd405e4503415bcdd640f126f74090a1fa401635e54018510d41d62e0741fdd307419f7e03410bf00f41f3811141b7600b415004234142fa2341df440d41758d2741e4180a41012ffc40653217411c5006415ec500415cc10b418e260a4146a0054118460741bfe20a41da6002413d4b0141b521ef40166e0041ed1b00415c4ffe40c13a00412b5c0941fb52fa401d140141c9dc084172920c4132df0d41796011417ef0fd408e490841edad14419a39234178a80b4103b6284168571b41f6350b4152892241ec02554192c50541781c374132242441');
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',1,'ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7','expert',X'2181acb5fc1a3bc0566eab34c7b939c08d9ab435731a38c043738dc8a49836c0063a6900b44635c0eb36e4be4aab36c0bae0bd48cdfb36c09e9d0025bef336c01a27b2deff5a36c03a0673cded1839c0f0b983d8094f3ac05ae18c03880b3cc0126ae214bbff3bc01852d9d8465938c033ddbed4be4836c0a632b07126bc34c08916f1ceec4a34c0e0090591b14635c002f984d1841536c0e7c1c83a93fc37c008ca7808ae4f3ac072dcb3f1d7163bc022c7ed0e8e1d40c0',X'da50ef3e0bb5113f7956303f247b413fbce9593f3f003a3f1f6e3f3f6608403f994e443f403d293f147df23ea523e73ef511923e4817113fe983393f9783583f601a623fc7754e3fd6523e3f272c1f3f3091023f5a4ffe3eea795c3d',X'0000000000000000000000000000000000000000000000000000000000000000000000000300000000000000030000000300000003000000030000000300000003000000030000000300000003000000030000000300000002000000',X'0100000001000000010000000200000004000000050000000800000008000000070000000c0000000b0000000e0000001500000016000000170000001700000016000000160000001600000018000000190000001a00000005000000',X'90db1f412e1a0a410eba0741d6941d4100d0fa409d9f0041dd7a1f4142c5f6406a93cd40bcd6094113fbf4400f6cca40003300411aeeea406782bd404b55f5409b94ee40717ff140eca4d74026d50441702afe40c0efee4086110a41f864db403760f1407eef0241c920d440a44f0a4174380641c50601419f7e03410bf00f41f3811141323c0e411a6d1c41340f164104ff1141464c204167b00d41566903417c850441374bfb4056b509416bddeb40c3cfc9405e990041f21ee0402033b64038cfdc400f3ade405354ce4079f4e840db8fee40de51d1400f77f94008ac00417ae1c740ae18e2409d07074140b50741a51cf940eba60d41a3c51a4176ddef40a9950f411be929415bcb2141c7be2841a0273941');
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',2,'ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC','expert',X'0672eb025b623bc01719bfaaffde37c0c632ab148b6737c042951ab0b1e636c072199380711037c09478a21a37d636c0befb59ab9f4b37c0f80c5ec5a36837c0e50382898ed037c04a569aac2ec238c04db54df0c7e438c094cc7280f1b037c0c9710b6c3b0e37c07a4616917c7a36c0d6c6eda78a6a36c03908a092d25636c05e7b0a1d30d036c056201ad9ebae36c0242a98b08a7e3ac0269c256f947f3dc01a7b8550b9183fc0',X'4f4dd23e4f7b273fe68c303f0d553a3faa29373fa73d423f5703323ff4dc3b3f43dc403f3c8a303f9f882d3fc8c52f3fb99e393f73c7443fc1fb453f79783f3f3e61343f3c0b333f8579cc3ec4f2283ea709983d',X'010000000000000000000000000000000000000000000000000000000300000003000000030000000300000003000000030000000300000003000000030000000300000003000000030000000300000003000000',X'050000000400000004000000040000000400000008000000070000000b0000000c0000000d0000000e00000011000000120000001200000012000000130000001400000015000000160000001600000013000000',X'40230b41849f1641ec6214416f87f5407aaf034192f9fe403127df400c1b06410dca0041ebdce6404eb80a41ae88e0400541fa408ffff8409ccdee40cd6efd405e4503415bcdd640b3b6ec40757905415acaf140110bf3409338fc40d4d0fd40f8be01417b240b41ec4ae040af3bfb400ccf1c410e6ce340708c05418bfb0e410789f340c28c0041e92a0641dbaee840fe51f740f26d08418b99d940683bed40264c0341dd7bdb402c70e8408e9206410ebcd7400b52f140202001410648d7407958f7401fabf8406c02ea40ececf940002907418f9ecd4074fa03417d7f1c41bb6e07412fdc0041c1602a4156bc2c4197780b4104663a41fbac2b41');
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',3,'ep_01M7ZBBWEVFJGPKW93DF12F6GF','expert',X'403614b6fe8c40c01163bf631c5a3bc0163b50104f203ac01eba0b7cef9839c0020bba131d7c39c03b425f2fbf6a39c09774d8550ac639c0d054c5ff6d3039c0ef3de6723a7239c046038022d4a938c0e8af125c951b38c0f80c5ec5a36837c0e50382898ed037c04a569aac2ec238c04db54df0c7e438c00f2ef42542a538c0603d2adecf0d39c07f7b99eb320137c0d6c6eda78a6a36c03908a092d25636c0bb78d7a33e5436c09cb4145272c435c08916f1ceec4a34c0a632b07126bc34c0e7c1c83a93fc37c008ca7808ae4f3ac072dcb3f1d7163bc0ee4329e94e6541c0',X'0000000021ddd03e730c003f0677003f8d66073f4f5a103f8c22083f865d133ff1ca0f3f24cb1e3ff170293fe52b323f5bb7353f762b1f3f49a01e3fc8f61d3f481e163f5786343fd6f93c3fadc03b3f5e91403ff94c483f1497683f73bf5c3f9561293feb9d0a3f48b7053f00000000',X'00000000020000000200000000000000000000000200000002000000020000000200000002000000020000000200000002000000020000000200000002000000020000000200000002000000020000000100000001000000010000000100000001000000010000000100000002000000',X'06000000030000000300000005000000070000000500000004000000040000000500000005000000050000000700000008000000090000000a0000000b0000000b0000000d0000000e0000000f000000100000000f000000100000000f00000013000000140000001500000006000000',X'14362b41b3d8364110912f41bb5417410f790e41fdd30f41ba3b0b4176e40641c1e40f4160ab0e4170780a41286b0041fc231341fb710341da2b0141cbf51241e609fe4035b10441ed2a1841b3a205410b26fd40fac80b41acfe06413a3f00410f170c41a6d10641f33a044133b30541677006414ff3fc4056200b416f6a0141215dea40110bf3409338fc40d4d0fd40f8be01417b240b41ec4ae040af3bfb400ccf1c410e6ce340708c05418bfb0e410789f340057e06416564f540eb23094116010941fc401341d935e94089f1f1400e3afd40c6faf0402c70e8408e9206410ebcd7400b52f140202001410648d740ecbeed4068dbfd4081edde40faf1eb4073ea04416bc7c24038cfdc400f3ade405354ce405e990041f21ee0402033b640ae18e2409d07074140b50741a51cf940eba60d41a3c51a4176ddef40a9950f411be92941ce6d3241133e4a41fcfd2f41');
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',4,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','imperfect',X'efa116d329de33c0016c5216a2d335c01e082bd592c236c09521129fd89536c06676d93e6d7e36c08715cbbbfbe735c050445e19b60336c0769ec18068b434c0247326c97e7f34c096904377a37d34c00ce98b66a07638c0484e1589922f3bc0916f760eaa343ac0700ec132dd913cc0e43e0536f80e3bc0ff97171c7ee439c0f0a4e4e3961a39c03ee453a11d0138c0be9a2a53292b38c0a86a4da7b06b38c066b39e104e1038c05e70968a40d738c082384c7b264e3cc0123ba90a5b7b3ec0f7a7afe6f7263bc082247d10886f39c0ca2533f7bb4039c0fe680395071535c0148d3a82a2fa34c08e7eb785611537c0959ae5337b2035c010a802a8ca5e36c0b71d90b4bfcf35c039f993eff8d335c0c769e5c596bd36c0a60d0770fa4c38c04398d5e4512f37c0e4f3b6daf74a34c0e2721dff978b37c017b8bdb292e535c049002603067e36c03b9f5308b89036c0f598dba296e636c00c0bb5ba241a36c0f09eb98fe39236c0764cc7c7248934c01aa1fd3f9e7e35c042b6f13261ed35c018eafac0c9cd36c0a28599cee7e036c08efce03fd52235c00309ad4fa7bb35c0ec3a5f47ff9c37c00eb6f550037736c04ce776380a2338c0fa812d6fe80736c0504cd331277636c0e2de2e2fd12f37c004dbc17ea69036c0c8f8d2586a3936c0',X'0000803f1b525b3fe3b2493f5cb1413f763f423f4bab4d3fecdc463f290e6b3f16036f3f648e6e3f54e6243ffa78d03e0ccfd63ef4989e3e069acd3e96d9f73e1fba0b3fef281a3f3e19213fb81c1c3f26dc1b3f9aeb103fbf1cb33e9abfb43d3842df3e2f4cff3e8ca00c3fef165d3f5157593fc6fa323f0d385c3f69223b3ffd67543f33304f3f1415443fcec9123f63203b3f14ad693fbbb0263f463a473f51793b3f0f39403f1a573a3f71dc493f7ddd393f74ea643f532a4f3fb493483f5c6d423f94742e3f0642513fba55453f3c59253fbf1a3f3f88551e3f97b24a3fc1c8363f24eb2a3fd493413f31ef463f',X'000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000003000000000000000100000000000000000000000200000002000000000000000200000002000000000000000000000003000000020000000200000002000000020000000200000000000000000000000000000002000000020000000200000000000000020000000300000003000000030000000200000002000000020000000000000003000000020000000200000000000000',X'000000000100000001000000020000000400000004000000050000000800000008000000090000000a0000000b0000000c0000000d0000000e0000000f0000001000000011000000060000000700000013000000140000000800000016000000080000000f00000004000000070000000e0000000d000000070000000f0000000b000000040000000800000015000000050000000d0000000e0000000e0000000e0000000700000004000000040000000e0000000d0000000e00000005000000050000001600000016000000160000000e0000000d0000000d00000006000000160000000f0000000c00000006000000',X'9d1011415832d640a971834078010b415298c94001d9da4005d11141c14ee2409061d24080430041a2050241cf28ce40c77f0041a87e0341c9d0c740ebbd0041ebcbf340b6b7c74095f7e0406f7f07415180d040f017cc40c3cbf4405da9d540d926c940742dfc408c9bca406dcdd7400b74e540f672d240c8c305412494f8402c5c0541a31a124163d70d412307134130b7ff40119a0a41f8d41841a52b144120631c410e8f1841a3a20741367b1141aad1174131140e41e8151441913bf84053f5ff407d2e074147800a4113d2f740bc7307412a6af940a148f74068460741b88fff40d814fd409d1e024101120641e6eeef40413109415ab8ff40d40ef4404b94084153d80a4198ec0a414eaa1b41814b1e41390b1c41b5491441c360374167320441a7da0f4170621e41398103412ad80c411e9f06411a26044101230c41a4c203418106e240b900dc40b899e440c594cb4085b4ea40060be940dd26e640435dda400914114166a9e2409694df406bd1e140feaf0141d437e3408641e540e102de407220dd40a4d4fe40a57de640b783e640c17ded407cedef405384f7400a41f040e649ff40ce9eeb404d5b0f41f42b004136a8da400f75054179b8d0403411d5404f95e3407acae040c522fa40e1420b411e95ec40b3f1e740852be840f9cee1404cc6ea40bd95014166d9e4407370f64027cdf6409447d2404da3ed40fa730e419bb3e6408d41ea406e4ff2401cd1e5409e00f940b78af3409a49d440882fce4076abee407744cf4015f3ea403b9cf5407639e74093e9f1401d89e440d251e84033c1d9401ad30b4112d9e94088d9ec4030b502411707d440960dde40fb45f240d231d4409642e5408200fe402584f34017e307419755f040709edc40466bde405aeb0941fea8e340f74cfa40a93513416305f840fcddf140ae19d74008ffd740f753ee40f438044154a400417d9beb400116f9404308fa40b942f440d4c9e340b3d7e5406ec4f2402a91ee40');
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',5,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09','imperfect',X'22a44c2948743ec0c43f6f5a22f23ac09ced1162f0bc3ac0f9207e3211ea3ac0ced1a8f0bcb53ac0cd40c762ef9d3ac0f209ff292e753cc0c76a696f38a53dc021657cf1b7db3bc00e15d8aa30eb3ac0c9a7ec555be139c044042c100bdf3bc0cc7df2d9ad1a3ac08b1d335039b53ac014288a0acb5137c08ba0de12114735c0b162b56791fe34c05da4d23392dd34c0478e4e6452b035c01e5fb36e602435c0b5ce3acacfba36c09cea5d5cebe734c0845723935d0836c07bc87d9c92c136c0c66469c6e3c23cc04acb3aa7b3ca3ac0904eee84b1d539c07b1b713796fb38c0081262004e4a35c003027e1481ad36c0e1ad24a177cf35c0868c7622670b37c0dc4a60e6e49937c01e5e801d1bd336c0b206e535d88e36c088bd0451ffe735c0dce65eb4ab6336c047945f3a01be36c07cf9a35eafea36c0a8cc6e73896f36c0854d14fd44fa35c0f2b509cb757836c01ec446f29d7435c0f475e79cabdf36c04a252c02f4f135c01f963b02b8bc35c0a029781bc34137c074b0fea0400436c00b4407bbba9d35c04c7be6664f0b36c01c7788ae3e7237c0a8f2a671d68136c076ecd446885636c048699cfe8c0d36c0e9bbd12383c336c05e85d08b2ff837c0a4d6c92e277e36c014bed27a006736c046503df42a1137c0b44fcc92dba037c0',X'634d3f3e0c73d73e4e1bd43e0628d73e6831f03ec4b0f73e4c79843e9d9b7f3eef39c43e7b34da3e4251023f143bd23e9380053f0857f83e40f0323fcb8e5a3f7f0d603ff5945b3f4f554b3f721f563f228e2f3fdf21543ff4883d3f9b78333ff9428f3e1da5c63efd63e83eb07c093f757d523f3877323fd840463fa08b373fc805203ff9f1363f96db343f6d0a473fe739383fd66b3d3f0d62393f3feb493f1fb0523f6d40493faaae5c3f5000403f3219413f674a573f0de6263fbfdc443f5ab2523f5c9c413f2bca353fe98c483fcc46453f3925443f785c3c3f769d213fced7363f80a5383fa1b02a3f01332c3f',X'020000000000000000000000000000000000000003000000020000000000000000000000020000000200000002000000020000000200000002000000020000000200000002000000020000000200000002000000020000000200000002000000000000000200000003000000030000000300000003000000020000000000000003000000000000000300000002000000030000000000000000000000000000000000000000000000000000000200000003000000000000000300000002000000000000000200000001000000000000000000000002000000000000000200000003000000030000000300000000000000',X'0500000004000000050000000700000008000000050000000f00000008000000080000000c0000000700000008000000090000000a0000000c0000000c0000000c0000000e0000000e0000000e0000001100000011000000110000000f000000070000000f000000150000001400000014000000160000000f000000040000001600000005000000160000000e000000160000000400000007000000080000000800000008000000080000000b0000001600000008000000160000000e000000070000000f0000000400000008000000040000000e000000070000000d00000015000000150000001600000004000000',X'1d0a2341e8932c417ea61741a2eb0741671019411d260e4134081141f78a1341db3b0741e8df0a417e4c0b41ad7418412d2418416c36104136010341d6c61741f22606412ef10b4173b412416f9a204101041441e32511411aae2f418a7f1941b9890e41ff812241c7af0c41847409415e78104129c6144145060a4155510f411cbe04410bc419414f4e224157de014135bb11411ca01241189ffa400f3f1a4199791041ed9a00412d29f440098010412210d540aa13da402047ff405787cf40d9fae340b8e6eb409cf0cf404865e340802a0041fef7b740ba80e540c4e4ee40cea4e1406d76ee40c37af940de9abc40ef44ef4021890a41c802d340e256ee402c12ef405d94bf406a50ec40610b084187a4c4404521fc40f85cfc4017b4df404daf0b4110ce0441dfb03b415d2a0941b928094125581a41dd9a0041bc05014180ba1b412216fe40f7e100415ccc0f412b8ad5403abfdc405b00f740bbd6e740c295f940a643f440169add40a291e1403dc3fa4031c0f040f6a4ea40de0303417dadde403412ee40763e1341f2ceea40a915f940c87ef64030cae740fcb4d940ed2d0841addfe740589bfb40e584d94073c3d64013cdf14078f201419315f140e57ff740b02aef40da64f1405c7ae9405b3b01412dc3da401775fd40eab8f5403d55de407514fa40eddee640c1bed5406a6707412481ea4035d5d940b44ef040d66fe4400e95e6401e3de540a4110841525bdb40d2e7fd405cfbe440b0d3d4408a07f640c6bbec409a3ed340198bf84058370e41634ae5408adaf1402763e94057b7ce40edc5ee40143af6407f6feb4078c1e140f638f440f249ee402c5bfa405cd1024121b1dd402e71ea403f0c0441644fe1405292e94053efff40417eef407dd0f240e262df40ff68d740e2a5fa40c2300341a795f9400672d54022ff1741a43ed8403d31e940822a074188e4e1403d8af0404a71fa400c13e5408ce1f44063180441589de440e2a101412b1d0641');
INSERT INTO episode_scores VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3',6,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y','imperfect',X'faad05fcdc6240c08af95d69afd93cc04eb198127eca3bc010e03bbf97113dc044ae989fd4113bc0e495888885c83bc0f4443ff1b0763dc0185e2d2a708f3cc0549b4475a47e3bc0e08d9fba8c023ac0965444fc2d4d3ac08f32b34e111d38c0776b1700b66e36c0cc6c1a90d4dd35c076209616871236c0ad75df12ce4036c0dd5e32a4f59036c0b44d5b8893f536c082c29a8a1d9239c01c1b97e66ff836c0ee6630927e8736c0e1e65dfa8a7c35c0d860c19bd46136c050c1daf595cb34c088be8ff0dd7d35c05d568e7b8a7e36c0a2c0cb7552d336c0b64ab4db350f36c0f638d6e037ef34c0a09f5621338b35c04699fae8bd8135c0a99505a0312b35c00549ee03b04a34c04863a7d8c32a34c06ac727cfb0df33c091f079a398cb34c0c42ae79a829d35c0f2525ccf568d35c014ecec2e1c6e35c091db9f40861039c0b44ff42bb1f135c0bd1fee8654b035c0b68155b1297e36c01f4b249b272c35c04de1a7456f0635c0eeb61bde9b9434c0f5bd4d4e24f434c0c7fcbc1d703235c0110fcdb457b236c045126bbf336736c06194da47eae835c094f96aa98bc134c0ff9dae4465a134c0084d7402ab7c35c0e61476d2602837c07d1e7239c48a34c0c712f60cc0e433c0f30df8fa43d834c031f32545cf7635c0a51ea14bc38635c0',X'00000000b5059a3e89b8c53eac09713e836be23eeb18c73e730d853e7a46973e9890c03ef27e053f504efc3e96ca1e3fd3bd3f3f0d5e443f4092403fe9ac3c3fe273393f65a02e3f1857f53edc8c353f3b8f413f3443503fa85e383f5fac623f2029503ff25b483fc4283b3fae114a3fdbf65f3f85b6543f556e553f089b503f1c796c3f6be66e3f43f67a3f6910583fbec14f3fb1fe503f5fce4d3f8d940f3f31504c3fd25a513f9744423f7b6f583f614d5a3fbd09643f79d7593f580a503f7d4e3e3f1961433fb30d4d3f7b81633f1bf3653f4c3a513f6f86313f40cb633f8680713f6de65c3f43b8523fbf0c553f',X'020000000200000002000000000000000000000000000000000000000000000000000000000000000200000002000000000000000000000000000000000000000000000000000000000000000000000000000000030000000300000000000000030000000200000000000000000000000000000000000000000000000300000000000000000000000000000003000000020000000200000002000000000000000000000000000000000000000200000000000000020000000200000003000000000000000000000000000000000000000000000000000000020000000000000002000000030000000200000000000000',X'030000000400000005000000050000000800000008000000090000000600000007000000080000000b0000000d0000000f00000012000000110000001200000013000000120000001200000014000000040000001300000016000000070000001300000005000000070000000700000007000000040000000400000016000000070000000700000008000000160000000d0000000d0000000f000000070000000700000006000000040000000d000000050000000d0000000e000000160000000400000007000000060000000600000006000000050000000d000000050000000d000000130000000d00000004000000',X'0eb520418bf93c4107ad2e41120824418d591a4158390f41abbe1441847c1641b26c114107ca1f4182cd2a41f3810641da9d1241f4cb1a417cb303417a441641802616415e1d1041700b1141fa8f1241a5cf3341b92c1c41d940144170891841da401841733f0641fa691941d4f80e41dbf109411c3e0741d0610b41234e0e41ed220b414837fe4003420641dce6f84034c8df405f210b41cecbd74081d6e44074220041289fd640ed3fea40308b074196fac8403e10ef408f80f340f588e540ea3bed40169406419fbad740df1cee40ef070041b585f0405c0dda403efd0641ed1d2541e5bfe440b3c3ff40648afa40b64fd64093f2fd408aadfc400376e540859de240d87de74070d3e04046a9e940efde0041abeecd40500aed40c379de4083d2d04069b4f040d234ee40a102e4408488ee402a46fd403f46d140fdacf74089bb08414ed5c540a01303412deaf54054eed140a3dce340051ce840b326e240fdf5f040b449de40b5d5d9405500ed40b361e94083c8dd40b303e840fe99df403697cf40efbee140dbffd7409728cf40d9ecd6400c43df4034b1ca40c142e0402402d140676ad44001efd940ad19eb40faf7cb406deaf340edcdf3402be6cd40c95ddf40733302413ad7dd40ae93db409e58f4406e60d5401cf60d41126218419e3fd340ef5bfb40989aef40e386d54086a0fd4028e3e2408e59ec40653f0241dfecde4053d5c5408936dd408c3c0141fe76e24064d7e240877fdb408935ca403362de40c0fbe940917ad5408f9ce5406a6de340ea10d8407769ef40a3d3de400a4ee440a819f44045e3fd40ed13cc408a21ec4081580a41fac6de40e16f00418c76dd408566d0405ba1e7409529e0405357d94097d9f240befbc740f0f6ea4081fade40efa3e5404b70df40c973e84003940e41e7cbdb401ec2e44083cad0402fc6c74097cbd8403c06dc405b53d5404c30e940d884dc40bf1fc5409125e6404dca0141710ce240904eee40687de040');
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
INSERT INTO episodes VALUES('ep_01M7ZBBVE2Z3BT14CB44SS1WK7','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-expert-000000.mcap','5bdbbf986f506fe0f87967579a78fe7c9f198df589c1c711c2da21740232f508',27107,26,2.5,'gleaner',0,'{"mapping":"gleaner","messages":156,"steps":26,"duration_ns":2500000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":26,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":26,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":26,"used":true}],"findings":[]}','success','expert',1795274698178,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-expert-000001.mcap','50d9eba328aa9c2c3dbea193ac9029a616cea8bc358f43a39583e80befc29813',24890,23,2.2000000000000001776,'gleaner',0,'{"mapping":"gleaner","messages":138,"steps":23,"duration_ns":2200000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":23,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":23,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":23,"used":true}],"findings":[]}','success','expert',1795274698615,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-expert-000002.mcap','9b84f08604e82ec2d463b1d05eb9fb432bcb0bf057d8a16304e7e1d49804a5c0',22497,21,2.0,'gleaner',0,'{"mapping":"gleaner","messages":126,"steps":21,"duration_ns":2000000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":21,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":21,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":21,"used":true}],"findings":[]}','success','expert',1795274698925,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBBWEVFJGPKW93DF12F6GF','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-expert-000003.mcap','c388b19dcbf5e065fbd48624ee63fa3df9f7d7ac456f6bad79577148233b19b3',28513,28,2.7000000000000001776,'gleaner',0,'{"mapping":"gleaner","messages":168,"steps":28,"duration_ns":2700000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":28,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":28,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":28,"used":true}],"findings":[]}','success','expert',1795274699227,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBBWRAKVJKKKT6SS8MF054','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-wrong_goal-000004.mcap','2043674071a173869178eb858597cc62640da62f063ccd2a8174df2ea046a9af',43724,60,5.9000000000000003552,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','wrong_goal',1795274699530,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBBX2Y44RRB7WDQF9EZA09','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-wrong_goal-000005.mcap','9fcf7fc74945eb2af1d37d4a0f24a435a0f7ecd8a34276e65cec688d3b354159',49575,60,5.9000000000000003552,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','wrong_goal',1795274699870,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBBXH5CGSQD735C9JV4W0Y','task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_cube-wrong_goal-000006.mcap','c5f5c2bb0cec5390e6b4714a5819263172d70830cbe6ef27e2a942921b2cdb2a',49325,60,5.9000000000000003552,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','failure','wrong_goal',1795274700325,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC0K1EZR6VZ4981E7CW6M','task_01M7ZBBSHEDMXH49VZST4HGV4W','ses_01M7ZBC08PSM40YYBVMATPZBVA.mcap','31c313f8fd89d75e21b5a4efbc8113af5b1bae9bea808484bb2e2c3410939a13',15538,4,0.29999999999999998889,'gleaner',0,'{"mapping":"gleaner","messages":28,"steps":4,"duration_ns":300000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":4,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":4,"used":true},{"topic":"/camera/table/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":4,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":4,"used":true},{"topic":"/policy/action","schema":"","encoding":"json","messages":4,"used":false},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":4,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":4,"used":true}],"findings":[]}','success','mysim',1795274703457,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC0XVB22EYFQEF5YD9KWX','task_01M7ZBBSHEDMXH49VZST4HGV4W','ses_01M7ZBC0K56C7N89MCFS310DAA.mcap','ca89f88a5541cba66d663c56f5e035a0ec647e7344fa6d1ea057cb80631263f4',21128,6,0.5,'gleaner',0,'{"mapping":"gleaner","messages":42,"steps":6,"duration_ns":500000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/camera/table/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/policy/action","schema":"","encoding":"json","messages":6,"used":false},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":6,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":6,"used":true}],"findings":[]}','failure','mysim',1795274703803,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC19ANVEP7HVJKNGAHMP4','task_01M7ZBBSHEDMXH49VZST4HGV4W','ses_01M7ZBC0YA0ZJ0X7REZB3WY5SR.mcap','f173b3569184f10dbd1b76b59f955749931757b0177d39ef8db25d4461005eb5',21164,6,0.5,'gleaner',0,'{"mapping":"gleaner","messages":42,"steps":6,"duration_ns":500000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/camera/table/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":6,"used":true},{"topic":"/policy/action","schema":"","encoding":"json","messages":6,"used":false},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":6,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":6,"used":true}],"findings":[]}','failure','tuesday',1795274704170,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC1KY5XN74T5071YVKEHP','task_01M7ZBBSHEDMXH49VZST4HGV4W','ses_01M7ZBC19EAZ58JD9AWG5QQJT2.mcap','80e8902938ed779ab042ecf2ebbaaf423e8bfc18a00e9c9260fe5f83d9d6d247',7430,2,0.10000000000000000555,'gleaner',0,'{"mapping":"gleaner","messages":14,"steps":2,"duration_ns":100000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":2,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":2,"used":true},{"topic":"/camera/table/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":2,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":2,"used":true},{"topic":"/policy/action","schema":"","encoding":"json","messages":2,"used":false},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":2,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":2,"used":true}],"findings":[]}','unknown','tuesday',1795274704510,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC22TAD6128VKQSRV4TCV','task_01M7ZBBSHEDMXH49VZST4HGV4W','ses_01M7ZBC1P6H66FNHYWH1SJV9Z0.mcap','5c24d3a2c6bcb913f630b76c61d9672a0b5ef29974b18eca3da500f766741749',5275,3,0.2000000000000000111,'gleaner',0,'{"mapping":"gleaner","messages":21,"steps":3,"duration_ns":200000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":3,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":3,"used":true},{"topic":"/camera/table/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":3,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":3,"used":true},{"topic":"/policy/action","schema":"","encoding":"json","messages":3,"used":false},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":3,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":3,"used":true}],"findings":[]}','success','evaluated',1795274704986,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC2EE33KW8CK6J70QPX93','task_01M7ZBBSHEDMXH49VZST4HGV4W','ses_01M7ZBC22Y456ADCTT5W5XVMWH.mcap','1a34dfb1af47b89096bf785e644b15549c276c898d22dbe8dea292088eba8619',5978,5,0.4000000000000000222,'gleaner',0,'{"mapping":"gleaner","messages":35,"steps":5,"duration_ns":400000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":5,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":5,"used":true},{"topic":"/camera/table/color","schema":"foxglove.RawImage","encoding":"protobuf","messages":5,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":5,"used":true},{"topic":"/policy/action","schema":"","encoding":"json","messages":5,"used":false},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":5,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":5,"used":true}],"findings":[]}','failure','evaluated',1795274705358,NULL,0,NULL);
INSERT INTO episodes VALUES('ep_01M7ZBC3K577CSMZRNDX687YSQ','task_01M7ZBC39EDGJQYBYBG9738NR5','pick_cube-wrong_goal-000004.mcap','2043674071a173869178eb858597cc62640da62f063ccd2a8174df2ea046a9af',43724,60,5.9000000000000003552,'gleaner',0,'{"mapping":"gleaner","messages":360,"steps":60,"duration_ns":5900000000,"rate_hz":10.0,"dropped_ticks":0,"topics":[{"topic":"/camera/hand/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/hand/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/color","schema":"foxglove.CompressedImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/camera/table/depth","schema":"foxglove.RawImage","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/action","schema":"gleaner.Action","encoding":"protobuf","messages":60,"used":true},{"topic":"/robot/state","schema":"gleaner.State","encoding":"protobuf","messages":60,"used":true}],"findings":[]}','unknown','',1795274706533,1763800000000,0,NULL);
CREATE TABLE evaluations (
    id text primary key,
    policy_id text not null references policies (id),
    job_id text references jobs (id),          -- null: reported from outside
    simulation text not null,
    seeds text not null,                       -- JSON list of the domain's SeedResult
    created_at integer not null
) strict;
INSERT INTO evaluations VALUES('eval_01M7ZBBZS7ZS79TG6K050ZZR3Q','pol_01M7ZBBXHQP9EY7KZS4QNNRH52','job_01M7ZBBZS7ZS79TG6K050ZZR3R','pick_cube','[{"seed":3,"episodes":2,"successes":0,"mean_steps":2.0}]',1795274702847);
INSERT INTO evaluations VALUES('eval_01M7ZBC01J0212B9KZ0BRTD8KH','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',NULL,'reach-v0','[{"seed":10,"episodes":4,"successes":2,"mean_steps":4.0}]',1795274702899);
INSERT INTO evaluations VALUES('eval_01M7ZBC02H4FAH5W6C241TE19H','pol_01M7ZBBXHQP9EY7KZS4QNNRH52',NULL,'mysim/pick-v0','[{"seed":0,"episodes":2,"successes":1,"mean_steps":4.0}]',1795274702929);
CREATE TABLE export_files (
    export_id text not null references exports (id),
    position integer not null,
    name text not null,
    blob text not null,
    size_bytes integer not null,
    primary key (export_id, position),
    unique (export_id, name)
) strict, without rowid;
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',0,'ep_01M7ZBBVE2Z3BT14CB44SS1WK7.mcap','5bdbbf986f506fe0f87967579a78fe7c9f198df589c1c711c2da21740232f508',27107);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',1,'ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7.mcap','50d9eba328aa9c2c3dbea193ac9029a616cea8bc358f43a39583e80befc29813',24890);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',2,'ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC.mcap','9b84f08604e82ec2d463b1d05eb9fb432bcb0bf057d8a16304e7e1d49804a5c0',22497);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',3,'ep_01M7ZBBWEVFJGPKW93DF12F6GF.mcap','c388b19dcbf5e065fbd48624ee63fa3df9f7d7ac456f6bad79577148233b19b3',28513);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',4,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_0-9.mcap','45a6aed4b8e364c468698f2be84ab726c7607a1b6ea9e81c022cabab34966030',13436);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',5,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_27-28.mcap','bd102905eafe72706efd6fe7d77c185a20ebadb0bbed8fed4473b471b570cdb7',6369);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',6,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_30-31.mcap','a8c947e36b6c18329b3267c3657861eee3fcdb57fae87ca2275d90b417641fbd',6603);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',7,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_32-34.mcap','d41413a095737e2148c3c5f8d8e6348d501e1572b3d7d6b96d82681d28632326',7030);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',8,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_36-37.mcap','090e62cb0e8e8f80a8e02c6ff8adbed2dd924c0f3d7e3d8db4c7f818e4667890',6506);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',9,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_39-40.mcap','f4665631c4afbe0dd6cc7637592003dded4d1fea815788d66f92acf179647b3a',6618);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',10,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_40-41.mcap','a6162c69211b2551e47e8fed93b02c06d2c778a07900bcc8a58db05e570a01a4',6627);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',11,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_42-43.mcap','3e33aa44a84d1265b4b1d0b8385b539b606e57282379c23bfeee04d21ea33d61',6511);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',12,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_45-48.mcap','845a985b4f9da2c27175ea84b98aab2d52988f86886361c0482b7079dbc66a04',7718);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',13,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_50-51.mcap','e043c357b4b8ee0bdd110d2b930967239d752a84ed52f84784f82f398c7d5bfa',6543);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',14,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_52-53.mcap','bb8db9933aeb4b2dbbecddc54cc859a177eb01de1c6de486e7fc577780a1f337',6509);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',15,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_55-56.mcap','603a2fd1dccf33fe27a792a3a0f5be77fb749616b1028d9111c220abd8cee60f',6518);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',16,'ep_01M7ZBBWRAKVJKKKT6SS8MF054_58-59.mcap','c72a11d0e4cc9a2f7fb140ad7032534dff5b2307039344b1f6666ecb2a18ef7f',6424);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',17,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_15-19.mcap','55961d0699d60457b17e743ac8f76e5bbc548cb600cc8a82e6021aa04bb37ee8',9347);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',18,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_21-22.mcap','f2311fb0405f623e9db7844f2c51a101d5482039dfa1cfb21429ac21520e0395',6813);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',19,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_28-29.mcap','a8754d6791e38d25e92560434fb44aeefa0de8f2776052f44e1bd4b7febf95a9',6717);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',20,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_30-31.mcap','3bb4fe2c053e4fd2306b2dc0710fed1e534c8ac9dbe503b9bdf35b6253bbcb20',6689);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',21,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_35-36.mcap','cfa87b814e42315ea528b0d9e6e61d4466db7fc435ef0d2903c188be692696ea',6712);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',22,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_39-45.mcap','cd6a4ba0142df915d3dbc966933a06c0d5967ee320e974c009fcd71371775b5d',9970);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',23,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_47-49.mcap','c5845c37f1e4f3a0df76d41f3d741ca4d1aef962f8bc9a0e5777b2ff4b112620',7518);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',24,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09_51-53.mcap','c7a6306d5fd5ee8a346c92ebb70f6e17c307f7628d672aae0ff52d776d13a670',7581);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',25,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_12-14.mcap','f3c985bcec06c99a0205673c5575221783cf7fe3ce18985bd7bd2ac9e09bc9b1',7541);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',26,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_20-21.mcap','8a0a1038a73b539d74231f4c6141f1fe6e221f703741a90ee362fbe9784fab0b',6711);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',27,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_23-25.mcap','b9202e24dbffb6ca0709bce90de331c21c47c727b4bbdb0749bbc28ceb8695e6',7428);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',28,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_27-38.mcap','8cb8d27844ef4fa2b9c1a0500cc2be48070a1d1a5aa0cd9f708151834a4dc4ad',13985);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',29,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_40-47.mcap','858cd821207220d4276b950f3f4c867135314d81ff6fceb3ac92f003d5b1bf66',11602);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',30,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_49-53.mcap','acd5967ce9ccb7c3f63bb7b1f953bf60a0db66c0044e24e7e4a0aac4ca918429',8919);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',31,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y_55-59.mcap','5251c8cbb5b579cffd54cc8cff56d8b136e25549239bcdac774fdd6fa0c306f1',9130);
INSERT INTO export_files VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0',32,'manifest.jsonl','4f4ee072582f39533cb3a6e283bd0973166d5195f99aa3f75d25b37820d68f83',17432);
CREATE TABLE exports (
    id text primary key,
    dataset_id text not null references datasets (id),
    job_id text not null references jobs (id),
    created_at integer not null
) strict;
INSERT INTO exports VALUES('exp_01M7ZBC498YCYE2K3CRCQWB9P0','ds_01M7ZBBYW3RXT2S0Z5EZTDAS1G','job_01M7ZBC498YCYE2K3CRCQWB9P1',1795274707779);
CREATE TABLE job_dependencies (
    job_id text not null references jobs (id),
    needs text not null references jobs (id),
    primary key (job_id, needs)
) strict, without rowid;
INSERT INTO job_dependencies VALUES('job_01M7ZBBXHFXTAZZ6H72XEAGWT4','job_01M7ZBBXH9XMVV35ET6Q38RN2Q');
INSERT INTO job_dependencies VALUES('job_01M7ZBBXHQP9EY7KZS4QNNRH53','job_01M7ZBBXH9XMVV35ET6Q38RN2Q');
INSERT INTO job_dependencies VALUES('job_01M7ZBC3WWXB5SSWGVA2DY50AF','job_01M7ZBBXH9XMVV35ET6Q38RN2Q');
INSERT INTO job_dependencies VALUES('job_01M7ZBC498YCYE2K3CRCQWB9P1','job_01M7ZBBXHFXTAZZ6H72XEAGWT4');
INSERT INTO job_dependencies VALUES('job_01M7ZBBZS7ZS79TG6K050ZZR3R','job_01M7ZBBXHQP9EY7KZS4QNNRH53');
CREATE TABLE job_metrics (
    -- The order of arrival, where `watch` goes on; never used again when a resumed job's metrics are cut back.
    id integer primary key autoincrement,
    job_id text not null references jobs (id),
    step integer not null,
    name text not null,
    value real not null
) strict;
INSERT INTO job_metrics VALUES(1,'job_01M7ZBBXH9XMVV35ET6Q38RN2Q',1,'loss',1.9957723617553710937);
INSERT INTO job_metrics VALUES(2,'job_01M7ZBBXH9XMVV35ET6Q38RN2Q',1,'loss_mtp',0.86081647872924804687);
INSERT INTO job_metrics VALUES(3,'job_01M7ZBBXH9XMVV35ET6Q38RN2Q',1,'loss_tr',0.90779012441635131835);
INSERT INTO job_metrics VALUES(4,'job_01M7ZBBXH9XMVV35ET6Q38RN2Q',1,'loss_aa',0.22716571390628814697);
INSERT INTO job_metrics VALUES(5,'job_01M7ZBBXH9XMVV35ET6Q38RN2Q',1,'grad_norm',10.984784207500762675);
INSERT INTO job_metrics VALUES(6,'job_01M7ZBBXH9XMVV35ET6Q38RN2Q',1,'learning_rate',0.0005000000000000000104);
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
INSERT INTO jobs VALUES('job_01M7ZBBXH9XMVV35ET6Q38RN2Q','task_01M7ZBBSHEDMXH49VZST4HGV4W','pretrain','{"kind":"pretrain","snapshot_id":"snap_01M7ZBBXH88HHJXQJSB8KM952T","spec":{"model":{"preset":"tiny","segment_length":3},"objectives":["mtp","tr","aa"],"augmentation":{"shift_pixels":0,"brightness":0.0,"contrast":0.0},"optim":{"steps":3,"batch":8,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":2,"clip_norm":1.0},"seed":7,"checkpoint_every":500,"device":"cpu","threads":null}}','succeeded',0,'enc_01M7ZBBXH9XMVV35ET6Q38RN2P',3,3,'done','',1,3,0,NULL,NULL,NULL,183087104,1795274700329,1795274700335,1795274700674,'','');
INSERT INTO jobs VALUES('job_01M7ZBBXHFXTAZZ6H72XEAGWT4','task_01M7ZBBSHEDMXH49VZST4HGV4W','score','{"kind":"score","encoder_id":"enc_01M7ZBBXH9XMVV35ET6Q38RN2P","snapshot_id":"snap_01M7ZBBXH88HHJXQJSB8KM952T","extends":null,"spec":{"scorer":"ssdf","similarity":"last_l2","feature_scale":"whitened","yardstick":"local","normaliser":"minmax","modality_scale":null,"seed":0,"device":"cpu","threads":null}}','succeeded',0,'run_01M7ZBBXHFXTAZZ6H72XEAGWT3',376,376,'done','',1,3,0,NULL,NULL,NULL,177491968,1795274700337,1795274700866,1795274701288,'','');
INSERT INTO jobs VALUES('job_01M7ZBBXHQP9EY7KZS4QNNRH53','task_01M7ZBBSHEDMXH49VZST4HGV4W','train','{"kind":"train","encoder_id":"enc_01M7ZBBXH9XMVV35ET6Q38RN2P","snapshot_id":"snap_01M7ZBBXH88HHJXQJSB8KM952T","dataset_id":null,"spec":{"policy":"finetune","model":{"preset":"tiny","segment_length":6},"act":{"chunk_length":10,"kl_weight":10.0,"latent_size":16},"augmentation":{"shift_pixels":0,"brightness":0.0,"contrast":0.0},"history_dropout":0.5,"optim":{"steps":3,"batch":8,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":2,"clip_norm":1.0},"lambda":0.1,"seed":7,"checkpoint_every":500,"device":"cpu","threads":null}}','succeeded',0,'pol_01M7ZBBXHQP9EY7KZS4QNNRH52',3,3,'done','',1,3,0,NULL,NULL,NULL,171794432,1795274700343,1795274701392,1795274701684,'','');
INSERT INTO jobs VALUES('job_01M7ZBBZ136F54N8W0RRNW9N5V','task_01M7ZBBSHEDMXH49VZST4HGV4W','train','{"kind":"train","encoder_id":null,"snapshot_id":"snap_01M7ZBBZ10DYZ587FYT1RPSHVC","dataset_id":null,"spec":{"policy":"bc","model":{"preset":"tiny","segment_length":6},"act":{"chunk_length":10,"kl_weight":10.0,"latent_size":16},"augmentation":{"shift_pixels":0,"brightness":0.0,"contrast":0.0},"history_dropout":0.5,"optim":{"steps":2,"batch":4,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":1,"clip_norm":1.0},"lambda":0.1,"seed":0,"checkpoint_every":500,"device":"cpu","threads":null}}','succeeded',0,'pol_01M7ZBBZ136F54N8W0RRNW9N5T',2,2,'done','',1,3,0,NULL,NULL,NULL,162926592,1795274701859,1795274701860,1795274702179,'','');
INSERT INTO jobs VALUES('job_01M7ZBBZS7ZS79TG6K050ZZR3R','task_01M7ZBBSHEDMXH49VZST4HGV4W','evaluate','{"kind":"evaluate","policy_id":"pol_01M7ZBBXHQP9EY7KZS4QNNRH52","spec":{"simulation":"pick_cube","episodes":2,"seeds":[3],"max_steps":2,"device":"cpu"}}','succeeded',0,'eval_01M7ZBBZS7ZS79TG6K050ZZR3Q',2,2,'done','',1,3,0,NULL,NULL,NULL,152211456,1795274702631,1795274702640,1795274702847,'','');
INSERT INTO jobs VALUES('job_01M7ZBC3WWXB5SSWGVA2DY50AF','task_01M7ZBBSHEDMXH49VZST4HGV4W','train','{"kind":"train","encoder_id":"enc_01M7ZBBXH9XMVV35ET6Q38RN2P","snapshot_id":"snap_01M7ZBBXH88HHJXQJSB8KM952T","dataset_id":null,"spec":{"policy":"finetune","model":{"preset":"tiny","segment_length":6},"act":{"chunk_length":10,"kl_weight":10.0,"latent_size":16},"augmentation":{"shift_pixels":0,"brightness":0.0,"contrast":0.0},"history_dropout":0.5,"optim":{"steps":100000,"batch":8,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":50,"clip_norm":1.0},"lambda":0.1,"seed":0,"checkpoint_every":500,"device":"cpu","threads":null}}','cancelled',0,'pol_01M7ZBC3WWXB5SSWGVA2DY50AE',0,0,'cancelled','',1,3,1,NULL,NULL,NULL,136544256,1795274706844,1795274706847,1795274707174,'long','{"kind":"train","data":{"experts_of":"enc_01M7ZBBXH9XMVV35ET6Q38RN2P"},"spec":{"policy":"finetune","model":{"preset":"tiny","segment_length":6},"act":{"chunk_length":10,"kl_weight":10.0,"latent_size":16},"augmentation":{"shift_pixels":0,"brightness":0.0,"contrast":0.0},"history_dropout":0.5,"optim":{"steps":100000,"batch":8,"stretch":8,"learning_rate":0.001,"weight_decay":0.01,"warmup_steps":50,"clip_norm":1.0},"lambda":0.1,"seed":0,"checkpoint_every":500,"device":"cpu","threads":null}}');
INSERT INTO jobs VALUES('job_01M7ZBC498YCYE2K3CRCQWB9P1','task_01M7ZBBSHEDMXH49VZST4HGV4W','export','{"kind":"export","dataset_id":"ds_01M7ZBBYW3RXT2S0Z5EZTDAS1G"}','succeeded',0,'exp_01M7ZBC498YCYE2K3CRCQWB9P0',32,32,'done','',1,3,0,NULL,NULL,NULL,135229440,1795274707240,1795274707241,1795274707780,'export','{"kind":"export","dataset_id":"ds_01M7ZBBYW3RXT2S0Z5EZTDAS1G"}');
CREATE TABLE labels (
    id integer primary key,
    episode_id text not null references episodes (id),
    outcome text not null check (outcome in ('success', 'failure', 'unknown')),
    cohort text not null,
    author text not null,
    reason text not null,
    created_at integer not null
) strict;
INSERT INTO labels VALUES(1,'ep_01M7ZBBVE2Z3BT14CB44SS1WK7','success','expert','','',1795274698178);
INSERT INTO labels VALUES(2,'ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7','success','expert','','',1795274698615);
INSERT INTO labels VALUES(3,'ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC','success','expert','','',1795274698926);
INSERT INTO labels VALUES(4,'ep_01M7ZBBWEVFJGPKW93DF12F6GF','success','expert','','',1795274699227);
INSERT INTO labels VALUES(5,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','failure','wrong_goal','','',1795274699530);
INSERT INTO labels VALUES(6,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09','failure','wrong_goal','','',1795274699870);
INSERT INTO labels VALUES(7,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y','failure','wrong_goal','','',1795274700326);
INSERT INTO labels VALUES(8,'ep_01M7ZBC0K1EZR6VZ4981E7CW6M','success','mysim','ses_01M7ZBC08PSM40YYBVMATPZBVA','',1795274703457);
INSERT INTO labels VALUES(9,'ep_01M7ZBC0XVB22EYFQEF5YD9KWX','failure','mysim','ses_01M7ZBC0K56C7N89MCFS310DAA','',1795274703803);
INSERT INTO labels VALUES(10,'ep_01M7ZBC19ANVEP7HVJKNGAHMP4','failure','tuesday','ses_01M7ZBC0YA0ZJ0X7REZB3WY5SR','',1795274704170);
INSERT INTO labels VALUES(11,'ep_01M7ZBC1KY5XN74T5071YVKEHP','unknown','tuesday','ses_01M7ZBC19EAZ58JD9AWG5QQJT2','',1795274704510);
INSERT INTO labels VALUES(12,'ep_01M7ZBC22TAD6128VKQSRV4TCV','success','evaluated','ses_01M7ZBC1P6H66FNHYWH1SJV9Z0','',1795274704986);
INSERT INTO labels VALUES(13,'ep_01M7ZBC2EE33KW8CK6J70QPX93','failure','evaluated','ses_01M7ZBC22Y456ADCTT5W5XVMWH','',1795274705358);
INSERT INTO labels VALUES(14,'ep_01M7ZBC3K577CSMZRNDX687YSQ','unknown','','','',1795274706534);
INSERT INTO labels VALUES(15,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','unknown','wrong_goal','ada','seen again',1795274706836);
INSERT INTO labels VALUES(16,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','failure','wrong_goal','','',1795274706837);
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
INSERT INTO policies VALUES('pol_01M7ZBBXHQP9EY7KZS4QNNRH52','task_01M7ZBBSHEDMXH49VZST4HGV4W','job_01M7ZBBXHQP9EY7KZS4QNNRH53','finetune','enc_01M7ZBBXH9XMVV35ET6Q38RN2P',NULL,'82f31ae5ac7a53ea6d84292e588cf19a53ad7d5e7d1fa61db27c58fb3dc33163',1795274701684);
INSERT INTO policies VALUES('pol_01M7ZBBZ136F54N8W0RRNW9N5T','task_01M7ZBBSHEDMXH49VZST4HGV4W','job_01M7ZBBZ136F54N8W0RRNW9N5V','bc',NULL,NULL,'7157e9f9f8b36c30f11463ae3eb92205601485dce349fc3a54ab71cbefdd7019',1795274702179);
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
, scorer text not null default 'ssdf', modality_scale text, extends text references score_runs (id), quantiles blob not null default x'', feature_scale text not null default 'plain', yardstick text not null default 'none') strict;
INSERT INTO score_runs VALUES('run_01M7ZBBXHFXTAZZ6H72XEAGWT3','task_01M7ZBBSHEDMXH49VZST4HGV4W','job_01M7ZBBXHFXTAZZ6H72XEAGWT4','enc_01M7ZBBXH9XMVV35ET6Q38RN2P','snap_01M7ZBBXH88HHJXQJSB8KM952T','last_l2','minmax',-1.4492140535246205157,-0.86164257509636332788,'["ep_01M7ZBBVE2Z3BT14CB44SS1WK7","ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7","ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC","ep_01M7ZBBWEVFJGPKW93DF12F6GF"]',1795274701287,'ssdf',NULL,NULL,X'','whitened','local');
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
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',0,'ep_01M7ZBBVE2Z3BT14CB44SS1WK7','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',1,'ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',2,'ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',3,'ep_01M7ZBBWEVFJGPKW93DF12F6GF','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',4,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',5,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T',6,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',0,'ep_01M7ZBBVE2Z3BT14CB44SS1WK7','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',1,'ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',2,'ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',3,'ep_01M7ZBBWEVFJGPKW93DF12F6GF','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',4,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',5,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC',6,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBC492E6ZWAY4T02VTH3GW',0,'ep_01M7ZBBVVQ1Q1Z1TV6F4WJK2Y7','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBC492E6ZWAY4T02VTH3GW',1,'ep_01M7ZBBW5D4XGNZ1NV2QNX5SHC','success','expert','expert');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBC492E6ZWAY4T02VTH3GW',2,'ep_01M7ZBBWRAKVJKKKT6SS8MF054','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBC492E6ZWAY4T02VTH3GW',3,'ep_01M7ZBBX2Y44RRB7WDQF9EZA09','failure','wrong_goal','imperfect');
INSERT INTO snapshot_episodes VALUES('snap_01M7ZBC492E6ZWAY4T02VTH3GW',4,'ep_01M7ZBBXH5CGSQD735C9JV4W0Y','failure','wrong_goal','imperfect');
CREATE TABLE snapshots (
    id text primary key,
    task_id text not null references tasks (id),
    rule text not null,              -- JSON of the domain's RoleRule
    created_at integer not null
) strict;
INSERT INTO snapshots VALUES('snap_01M7ZBBXH88HHJXQJSB8KM952T','task_01M7ZBBSHEDMXH49VZST4HGV4W','{"expert_cohorts":[],"imperfect_cohorts":[],"imperfect_per_expert":0.0,"max_experts":0,"seed":0}',1795274700328);
INSERT INTO snapshots VALUES('snap_01M7ZBBZ10DYZ587FYT1RPSHVC','task_01M7ZBBSHEDMXH49VZST4HGV4W','{"expert_cohorts":[],"imperfect_cohorts":[],"imperfect_per_expert":0.0,"max_experts":0,"seed":0}',1795274701856);
INSERT INTO snapshots VALUES('snap_01M7ZBC492E6ZWAY4T02VTH3GW','task_01M7ZBBSHEDMXH49VZST4HGV4W','{"expert_cohorts":["expert"],"imperfect_cohorts":["wrong_goal"],"imperfect_per_expert":0.0,"max_experts":2,"seed":5}',1795274707234);
CREATE TABLE tasks (
    id text primary key,
    name text not null unique,
    spec text not null,              -- JSON of the recording crate's TaskSpec
    created_at integer not null      -- every time here is milliseconds since 1970, UTC
) strict;
INSERT INTO tasks VALUES('task_01M7ZBBSHAJDEG2Q1BBYYQNCEM','pick_cube','{"name":"pick_cube","rate_hz":10.0,"cameras":[{"name":"table","height":32,"width":32,"depth":true},{"name":"hand","height":32,"width":32,"depth":true}],"proprioception":[{"name":"tool_position","size":3},{"name":"tool_yaw","size":2},{"name":"gripper_width","size":1},{"name":"tool_velocity","size":3},{"name":"goal","size":3},{"name":"goal_from_tool","size":3}],"action":[{"name":"delta_position","size":3},{"name":"delta_rotation","size":3},{"name":"gripper","size":1}],"alignment":"latest_before","tolerance":0.25,"mappings":[{"name":"gleaner","cameras":[{"camera":"table","color":"/camera/table/color","depth":"/camera/table/depth"},{"camera":"hand","color":"/camera/hand/color","depth":"/camera/hand/depth"}],"fields":[{"field":"tool_position","topic":"/robot/state","paths":["tool_position"]},{"field":"tool_yaw","topic":"/robot/state","paths":["tool_yaw"]},{"field":"gripper_width","topic":"/robot/state","paths":["gripper_width"]},{"field":"tool_velocity","topic":"/robot/state","paths":["tool_velocity"]},{"field":"goal","topic":"/robot/state","paths":["goal"]},{"field":"goal_from_tool","topic":"/robot/state","paths":["goal_from_tool"]},{"field":"delta_position","topic":"/robot/action","paths":["delta_position"]},{"field":"delta_rotation","topic":"/robot/action","paths":["delta_rotation"]},{"field":"gripper","topic":"/robot/action","paths":["gripper"]}],"clock":"/robot/action"}]}',1795274696234);
INSERT INTO tasks VALUES('task_01M7ZBBSHEDMXH49VZST4HGV4W','pick_small','{"name":"pick_small","rate_hz":10.0,"cameras":[{"name":"table","height":16,"width":16,"depth":true},{"name":"hand","height":16,"width":16,"depth":true}],"proprioception":[{"name":"tool_position","size":3},{"name":"tool_yaw","size":2},{"name":"gripper_width","size":1},{"name":"tool_velocity","size":3},{"name":"goal","size":3},{"name":"goal_from_tool","size":3}],"action":[{"name":"delta_position","size":3},{"name":"delta_rotation","size":3},{"name":"gripper","size":1}],"alignment":"latest_before","tolerance":0.25,"mappings":[{"name":"gleaner","cameras":[{"camera":"table","color":"/camera/table/color","depth":"/camera/table/depth"},{"camera":"hand","color":"/camera/hand/color","depth":"/camera/hand/depth"}],"fields":[{"field":"tool_position","topic":"/robot/state","paths":["tool_position"]},{"field":"tool_yaw","topic":"/robot/state","paths":["tool_yaw"]},{"field":"gripper_width","topic":"/robot/state","paths":["gripper_width"]},{"field":"tool_velocity","topic":"/robot/state","paths":["tool_velocity"]},{"field":"goal","topic":"/robot/state","paths":["goal"]},{"field":"goal_from_tool","topic":"/robot/state","paths":["goal_from_tool"]},{"field":"delta_position","topic":"/robot/action","paths":["delta_position"]},{"field":"delta_rotation","topic":"/robot/action","paths":["delta_rotation"]},{"field":"gripper","topic":"/robot/action","paths":["gripper"]}],"clock":"/robot/action"}]}',1795274696238);
INSERT INTO tasks VALUES('task_01M7ZBC38NQ6WVKNT71VV67R6X','pour','{"name":"pour","rate_hz":12.5,"cameras":[{"name":"top","height":48,"width":64,"depth":true}],"proprioception":[{"name":"joints","size":2}],"action":[{"name":"delta","size":3}],"alignment":"nearest","tolerance":0.25,"mappings":[{"name":"ros","cameras":[{"camera":"top","color":"/rgb","depth":"/d"}],"fields":[{"field":"joints","topic":"/joint_states","paths":["position"]},{"field":"delta","topic":"/cmd","paths":["linear.x","linear.y","linear.z"]}]}]}',1795274706197);
INSERT INTO tasks VALUES('task_01M7ZBC39EDGJQYBYBG9738NR5','resumed','{"name":"resumed","rate_hz":10.0,"cameras":[{"name":"table","height":16,"width":16,"depth":true},{"name":"hand","height":16,"width":16,"depth":true}],"proprioception":[{"name":"tool_position","size":3},{"name":"tool_yaw","size":2},{"name":"gripper_width","size":1},{"name":"tool_velocity","size":3},{"name":"goal","size":3},{"name":"goal_from_tool","size":3}],"action":[{"name":"delta_position","size":3},{"name":"delta_rotation","size":3},{"name":"gripper","size":1}],"alignment":"latest_before","tolerance":0.25,"mappings":[{"name":"gleaner","cameras":[{"camera":"table","color":"/camera/table/color","depth":"/camera/table/depth"},{"camera":"hand","color":"/camera/hand/color","depth":"/camera/hand/depth"}],"fields":[{"field":"tool_position","topic":"/robot/state","paths":["tool_position"]},{"field":"tool_yaw","topic":"/robot/state","paths":["tool_yaw"]},{"field":"gripper_width","topic":"/robot/state","paths":["gripper_width"]},{"field":"tool_velocity","topic":"/robot/state","paths":["tool_velocity"]},{"field":"goal","topic":"/robot/state","paths":["goal"]},{"field":"goal_from_tool","topic":"/robot/state","paths":["goal_from_tool"]},{"field":"delta_position","topic":"/robot/action","paths":["delta_position"]},{"field":"delta_rotation","topic":"/robot/action","paths":["delta_rotation"]},{"field":"gripper","topic":"/robot/action","paths":["gripper"]}],"clock":"/robot/action"}]}',1795274706222);
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
INSERT INTO audit VALUES(1,1763800000000,NULL,'ada','127.0.0.1:1','EpisodeService/DeleteEpisodes','[]','ok');
DELETE FROM sqlite_sequence;
INSERT INTO sqlite_sequence VALUES('job_metrics',61);
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
COMMIT;
