//! Migrations are embedded from outside this crate, so a change there must rebuild it.
fn main() {
    println!("cargo:rerun-if-changed=../migrations");
}
