//! A small tabletop simulator with rendered RGBD cameras.
