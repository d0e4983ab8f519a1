//! A network between a test and its PostgreSQL that can be cut: nothing arrives any more, and no connection ends.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    os::unix::net::UnixStream,
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};

use crate::Server;

/// A proxy in front of a server.
#[derive(Debug)]
pub struct Proxy {
    address: SocketAddr,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// Whether new connections forward nothing either.
    cut: bool,
    /// Of each connection: whether it forwards nothing any more.
    silenced: Vec<Arc<AtomicBool>>,
    /// The ends of silenced connections, which stay open on the side of the server.
    open: Vec<UnixStream>,
}

impl Proxy {
    /// Starts a proxy; its threads end with the process.
    pub fn start(server: &Server) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let (address, state) = (listener.local_addr().unwrap(), Arc::<Mutex<State>>::default());
        let (socket, shared) = (server.socket(), Arc::clone(&state));
        thread::spawn(move || {
            for client in listener.incoming() {
                connect(client.unwrap(), &socket, &shared);
            }
        });
        Self { address, state }
    }

    /// The address of a database behind the proxy.
    pub fn url(&self, database: &str) -> String {
        format!("postgres://gleaner@{}/{database}?sslmode=disable", self.address)
    }

    /// Cuts every connection without an end, and each new one.
    pub fn cut(&self) {
        let mut state = self.state.lock().unwrap();
        state.cut = true;
        state.silenced.iter().for_each(|silenced| silenced.store(true, Ordering::SeqCst));
    }

    /// Forwards new connections again; those that were cut stay silent.
    pub fn restore(&self) {
        self.state.lock().unwrap().cut = false;
    }
}

fn connect(client: TcpStream, socket: &PathBuf, state: &Arc<Mutex<State>>) {
    let Ok(server) = UnixStream::connect(socket) else { return };
    let mut shared = state.lock().unwrap();
    let silenced = Arc::new(AtomicBool::new(shared.cut));
    shared.silenced.push(Arc::clone(&silenced));
    shared.open.push(server.try_clone().unwrap());
    drop(shared);
    let there = (client.try_clone().unwrap(), server.try_clone().unwrap(), Arc::clone(&silenced));
    thread::spawn(move || {
        let (from, to, silenced) = there;
        forward(&from, &to, &silenced);
        if !silenced.load(Ordering::SeqCst) {
            // It has ended already if this fails.
            let _ = to.shutdown(std::net::Shutdown::Both);
        }
    });
    thread::spawn(move || {
        forward(&server, &client, &silenced);
        if !silenced.load(Ordering::SeqCst) {
            let _ = client.shutdown(std::net::Shutdown::Both);
        }
    });
}

/// Forwards until the end of either side; reads on and forwards nothing once the connection is silenced.
fn forward(mut from: impl Read, mut to: impl Write, silenced: &AtomicBool) {
    let mut bytes = [0; 16 << 10];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        if !silenced.load(Ordering::SeqCst) && to.write_all(&bytes[..count]).is_err() {
            return;
        }
    }
}
