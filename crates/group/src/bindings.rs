//! The declarations of `cpp/group.cpp`, and safe functions over them. The only file of the workspace with `unsafe` code:
//! every pointer that crosses the border is made and freed here.

#![allow(unsafe_code, reason = "libtorch's process groups and its switch of TF32 are C++, and tch does not bind them")]
#![warn(clippy::undocumented_unsafe_blocks, clippy::multiple_unsafe_ops_per_block)]

use std::{
    ffi::{CStr, CString, c_char, c_int, c_void},
    ptr::{self, NonNull},
    time::Duration,
};

use tch::Tensor;

/// Bytes of a message of libtorch, with its end.
const ROOM: usize = 2048;

#[repr(C)]
struct RawStore([u8; 0]);
#[repr(C)]
struct RawGroup([u8; 0]);

unsafe extern "C" {
    fn gleaner_group_has_nccl() -> c_int;
    fn gleaner_store_open(
        host: *const c_char,
        port: *mut u16,
        serves: c_int,
        ranks: c_int,
        timeout_ms: i64,
        out: *mut *mut RawStore,
        message: *mut c_char,
        room: usize,
    ) -> c_int;
    fn gleaner_store_set(
        store: *mut RawStore,
        key: *const c_char,
        value: *const c_char,
        message: *mut c_char,
        room: usize,
    ) -> c_int;
    fn gleaner_store_compare(
        store: *mut RawStore,
        key: *const c_char,
        value: *const c_char,
        timeout_ms: i64,
        same: *mut c_int,
        message: *mut c_char,
        room: usize,
    ) -> c_int;
    fn gleaner_group_join(
        store: *mut RawStore,
        name: *const c_char,
        rank: c_int,
        ranks: c_int,
        address: *const c_char,
        gpu: c_int,
        timeout_ms: i64,
        out: *mut *mut RawGroup,
        message: *mut c_char,
        room: usize,
    ) -> c_int;
    fn gleaner_group_sum(group: *mut RawGroup, tensor: *mut c_void, message: *mut c_char, room: usize) -> c_int;
    fn gleaner_group_broadcast(group: *mut RawGroup, tensor: *mut c_void, message: *mut c_char, room: usize) -> c_int;
    fn gleaner_tf32_allow(allowed: c_int, message: *mut c_char, room: usize) -> c_int;
    fn gleaner_tf32_allowed(allowed: *mut c_int, message: *mut c_char, room: usize) -> c_int;
    fn gleaner_group_leave(group: *mut RawGroup);
    fn gleaner_store_close(store: *mut RawStore);
}

/// Whether this build can sum on GPUs.
pub(crate) fn has_nccl() -> bool {
    // SAFETY: the function takes nothing and returns a number.
    unsafe { gleaner_group_has_nccl() != 0 }
}

/// Sets whether a GPU may multiply in TF32.
pub(crate) fn allow_tf32(allowed: bool) -> Result<(), String> {
    // SAFETY: the function takes a number, and `message` has room for `ROOM` bytes.
    called(|message| unsafe { gleaner_tf32_allow(allowed.into(), message, ROOM) })
}

/// Whether a GPU may multiply in TF32.
pub(crate) fn tf32_allowed() -> Result<bool, String> {
    let mut allowed = 0;
    let found = &mut allowed;
    // SAFETY: `found` is a place of this frame, and `message` has room for `ROOM` bytes.
    called(|message| unsafe { gleaner_tf32_allowed(found, message, ROOM) })?;
    Ok(allowed != 0)
}

/// The store by which ranks find each other.
pub(crate) struct Store(NonNull<RawStore>);

// SAFETY: c10d's stores guard their connection with a mutex, and this value owns its store.
unsafe impl Send for Store {}

impl Store {
    /// Serves the store at any port, or connects to the one at `port` of `host`. Also returns the port.
    pub(crate) fn open(
        host: &str,
        port: u16,
        serves: bool,
        ranks: u32,
        timeout: Duration,
    ) -> Result<(Self, u16), String> {
        let (host, mut port, mut out) = (text(host)?, port, ptr::null_mut());
        let (serves, ranks) = (c_int::from(serves), number(ranks)?);
        called(|message| {
            // SAFETY: `host` is a C string and outlives the call, `port` and `out` are places of this frame, and
            // `message` has room for `ROOM` bytes.
            unsafe {
                gleaner_store_open(
                    host.as_ptr(),
                    &mut port,
                    serves,
                    ranks,
                    milliseconds(timeout),
                    &mut out,
                    message,
                    ROOM,
                )
            }
        })?;
        NonNull::new(out).map(|store| (Self(store), port)).ok_or_else(nothing)
    }

    /// Writes a value for the other ranks.
    pub(crate) fn set(&self, key: &str, value: &str) -> Result<(), String> {
        let (key, value) = (text(key)?, text(value)?);
        // SAFETY: the store is alive, the strings are C strings and outlive the call, and `message` has room for `ROOM`
        // bytes.
        called(|message| unsafe { gleaner_store_set(self.0.as_ptr(), key.as_ptr(), value.as_ptr(), message, ROOM) })
    }

    /// Waits until a rank writes this key, and returns whether it wrote `value`.
    pub(crate) fn compare(&self, key: &str, value: &str, timeout: Duration) -> Result<bool, String> {
        let (key, value, mut same) = (text(key)?, text(value)?, 0);
        let (timeout, found) = (milliseconds(timeout), &mut same);
        // SAFETY: as in `set`; `found` is a place of this frame.
        called(|message| unsafe {
            gleaner_store_compare(self.0.as_ptr(), key.as_ptr(), value.as_ptr(), timeout, found, message, ROOM)
        })?;
        Ok(same != 0)
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        // SAFETY: the pointer is of `gleaner_store_open` and is freed once.
        unsafe { gleaner_store_close(self.0.as_ptr()) }
    }
}

/// A joined group.
pub(crate) struct Joined(NonNull<RawGroup>);

// SAFETY: c10d's process groups may be used from any thread, and this value owns its group.
unsafe impl Send for Joined {}

/// The place of one process in a group.
pub(crate) struct Place<'a> {
    pub(crate) name: &'a str,
    pub(crate) rank: u32,
    pub(crate) ranks: u32,
    pub(crate) address: &'a str,
    pub(crate) gpu: bool,
}

impl Joined {
    /// Joins the group of this name by the store, and returns when all ranks have.
    pub(crate) fn new(store: &Store, place: &Place<'_>, timeout: Duration) -> Result<Self, String> {
        let (name, address, mut out) = (text(place.name)?, text(place.address)?, ptr::null_mut());
        let (rank, ranks, gpu) = (number(place.rank)?, number(place.ranks)?, c_int::from(place.gpu));
        let timeout = milliseconds(timeout);
        called(|message| {
            // SAFETY: the store is alive, the strings are C strings and outlive the call, `out` is a place of this
            // frame, and `message` has room for `ROOM` bytes.
            unsafe {
                gleaner_group_join(
                    store.0.as_ptr(),
                    name.as_ptr(),
                    rank,
                    ranks,
                    address.as_ptr(),
                    gpu,
                    timeout,
                    &mut out,
                    message,
                    ROOM,
                )
            }
        })?;
        NonNull::new(out).map(Self).ok_or_else(nothing)
    }

    /// The tensor of every rank becomes the sum of all.
    pub(crate) fn sum(&self, tensor: &mut Tensor) -> Result<(), String> {
        let tensor = tensor.as_mut_ptr().cast();
        // SAFETY: the group is alive, tch's pointer is an `at::Tensor*` that is borrowed for the call, and `message` has
        // room for `ROOM` bytes.
        called(|message| unsafe { gleaner_group_sum(self.0.as_ptr(), tensor, message, ROOM) })
    }

    /// The tensor of every rank becomes that of rank 0.
    pub(crate) fn broadcast(&self, tensor: &mut Tensor) -> Result<(), String> {
        let tensor = tensor.as_mut_ptr().cast();
        // SAFETY: as in `sum`.
        called(|message| unsafe { gleaner_group_broadcast(self.0.as_ptr(), tensor, message, ROOM) })
    }
}

impl Drop for Joined {
    fn drop(&mut self) {
        // SAFETY: the pointer is of `gleaner_group_join` and is freed once.
        unsafe { gleaner_group_leave(self.0.as_ptr()) }
    }
}

/// Calls a function of the border; its message is the error.
fn called(call: impl FnOnce(*mut c_char) -> c_int) -> Result<(), String> {
    let mut message = [0u8; ROOM];
    if call(message.as_mut_ptr().cast()) == 0 {
        return Ok(());
    }
    let text = CStr::from_bytes_until_nul(&message).map(CStr::to_string_lossy).unwrap_or_default();
    // libtorch appends its C++ stack.
    Err(text.lines().next().unwrap_or_default().to_owned())
}

fn text(text: &str) -> Result<CString, String> {
    CString::new(text).map_err(|_| format!("{text:?} contains a zero byte"))
}

fn number(number: u32) -> Result<c_int, String> {
    c_int::try_from(number).map_err(|_| format!("{number} is too large"))
}

fn milliseconds(timeout: Duration) -> i64 {
    i64::try_from(timeout.as_millis()).unwrap_or(i64::MAX)
}

fn nothing() -> String {
    "libtorch returned no object".to_owned()
}
