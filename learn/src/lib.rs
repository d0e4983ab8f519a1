//! SSDF: pretraining, quality scores and policies, on tensors.
