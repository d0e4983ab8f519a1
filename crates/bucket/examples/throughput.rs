//! The rates of uploads and reads of one file through `Bucket`, and through `object_store` alone, on the same store:
//! `throughput MIB ROUNDS` on the store of the tests (moto, or the one that `GLEANER_TEST_S3` names), and `throughput MIB
//! ROUNDS ENDPOINT BUCKET` on another, with credentials from the environment.

#![expect(
    clippy::expect_used,
    clippy::print_stderr,
    clippy::print_stdout,
    reason = "a measurement ends at the first failure, and prints its result"
)]

use std::{fs::File, path::Path, time::Instant};

use gleaner_bucket::{
    Bucket, BucketConfig,
    testing::{BUCKET, KEY, KEY_ID, TestStore},
};
use gleaner_core::id::BlobId;
use object_store::{
    ObjectStoreExt as _, WriteMultipart,
    aws::{AmazonS3, AmazonS3Builder},
    path::Path as Key,
};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (mib, rounds, store, (ours, alone)) = match *arguments {
        [mib, rounds] => {
            let store = TestStore::start().expect("a store").expect("moto (make moto)");
            let clients = of_tests(&store);
            (mib, rounds, Some(store), clients)
        }
        [mib, rounds, endpoint, bucket] => (mib, rounds, None, named(endpoint, bucket)),
        _ => {
            eprintln!("throughput MIB ROUNDS [ENDPOINT BUCKET]");
            std::process::exit(2);
        }
    };
    let (mib, rounds) = (mib.parse::<usize>().expect("MIB"), rounds.parse::<usize>().expect("ROUNDS"));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("threads");
    let content: Vec<u8> = (0..=250).cycle().take(mib << 20).collect();
    let digest = BlobId::from(blake3::hash(&content));
    let dir = tempfile::tempdir().expect("a folder");
    let (from, to) = (dir.path().join("from"), dir.path().join("to"));
    std::fs::write(&from, &content).expect("the disk has room");
    let key = Key::from("alone");
    let mut seconds = [f64::INFINITY; 4];
    let mut timed = |at: usize, work: &dyn Fn()| {
        let begun = Instant::now();
        work();
        seconds[at] = seconds[at].min(begun.elapsed().as_secs_f64());
    };
    for _ in 0..rounds {
        timed(0, &|| ours.put("ours", &from).expect("a put"));
        timed(1, &|| runtime.block_on(send(&alone, &key, &from)));
        timed(2, &|| {
            ours.fetch("ours", &digest, &File::create(&to).expect("a file")).expect("a fetch");
        });
        timed(3, &|| {
            let read = runtime.block_on(async { alone.get(&key).await.expect("a get").bytes().await });
            std::fs::write(&to, read.expect("a get")).expect("the disk has room");
        });
    }
    #[expect(clippy::cast_precision_loss, reason = "a rate")]
    let rates = seconds.map(|best| mib as f64 / best);
    let [put, put_alone, get, get_alone] = rates;
    println!("upload: {put:.0} MiB/s, object_store alone {put_alone:.0}: {:.2}", put / put_alone);
    println!("read: {get:.0} MiB/s, object_store alone {get_alone:.0}: {:.2}", get / get_alone);
    drop(store);
}

/// Both clients on the store of the tests.
fn of_tests(store: &TestStore) -> (Bucket, AmazonS3) {
    let config = store.config("throughput");
    let alone = AmazonS3Builder::new()
        .with_bucket_name(BUCKET)
        .with_endpoint(config.endpoint.as_deref().expect("an address"))
        .with_access_key_id(KEY_ID)
        .with_secret_access_key(KEY)
        .with_allow_http(true);
    (store.bucket("throughput").expect("the bucket can be used"), alone.build().expect("the bucket can be used"))
}

/// Both clients on the bucket of a store, with credentials from the environment.
fn named(endpoint: &str, bucket: &str) -> (Bucket, AmazonS3) {
    let ours = Bucket::open(&BucketConfig {
        url: format!("s3://{bucket}/throughput"),
        endpoint: Some(endpoint.to_owned()),
        region: None,
        http: true,
        virtual_host: false,
        timeout_seconds: 240,
    });
    let alone = AmazonS3Builder::from_env().with_bucket_name(bucket).with_endpoint(endpoint).with_allow_http(true);
    (ours.expect("the bucket can be used"), alone.build().expect("the bucket can be used"))
}

/// A file in pieces of the client's own size, several at once, as its documentation has it.
async fn send(store: &AmazonS3, key: &Key, from: &Path) {
    let content = std::fs::read(from).expect("the file can be read");
    let mut writing = WriteMultipart::new(store.put_multipart(key).await.expect("an upload"));
    writing.write(&content);
    writing.finish().await.expect("an upload");
}
