//! stub
#![allow(missing_docs)]
use crate::error::LearnError;
use crate::spec::{TaskShape, TrainSpec};
use crate::train::Monitor;
use crate::trajectory::{Trajectory, WeightedSegments};

pub struct Policy {
    shape: TaskShape,
}
#[derive(Debug, Clone, PartialEq)]
pub struct Embedding(Vec<f32>);
#[derive(Debug, Clone)]
pub struct History {
    window: usize,
}
impl History {
    pub fn new(segment_length: u32) -> Self {
        Self {
            window: segment_length as usize + 1,
        }
    }
    pub fn len(&self) -> usize {
        self.window
    }
    pub fn is_empty(&self) -> bool {
        self.window == 0
    }
    pub fn push(
        &mut self,
        _embedding: Embedding,
        _proprioception: Vec<f32>,
    ) -> Result<(), LearnError> {
        Ok(())
    }
    pub fn set_executed(&mut self, _action: Vec<f32>) -> Result<(), LearnError> {
        Ok(())
    }
}
impl Policy {
    pub fn load(_bytes: &[u8]) -> Result<Self, LearnError> {
        Err(LearnError::Torch("not built yet".into()))
    }
    pub fn shape(&self) -> &TaskShape {
        &self.shape
    }
    pub fn segment_length(&self) -> u32 {
        6
    }
    pub fn embed(&self, _frames: &[&[u8]]) -> Result<Vec<Embedding>, LearnError> {
        Err(LearnError::Torch("not built yet".into()))
    }
    pub fn act(&self, _histories: &[&History]) -> Result<Vec<Vec<f32>>, LearnError> {
        Err(LearnError::Torch("not built yet".into()))
    }
}
pub fn train_policy(
    _shape: &TaskShape,
    _encoder: &[u8],
    _experts: &[Trajectory],
    _kept: &[WeightedSegments],
    _spec: &TrainSpec,
    _resume: Option<&[u8]>,
    _monitor: &mut dyn Monitor,
) -> Result<Vec<u8>, LearnError> {
    Err(LearnError::Torch("not built yet".into()))
}
