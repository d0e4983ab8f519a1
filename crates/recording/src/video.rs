//! Video in recordings: which messages hold pictures, and the pictures of one camera in turn.
//!
//! foxglove.CompressedVideo, FFMPEGPacket of ROS's `ffmpeg_image_transport`, and a lab's own message with the fields of
//! either. The crate `gleaner-video` decodes; this module depends on no plan of steps.

mod camera;
mod first;
mod packet;
mod reel;

pub(crate) use camera::{Shown, Video};
pub(crate) use first::FirstPicture;
pub(crate) use packet::{Packet, packet};
pub(crate) use reel::Reel;
