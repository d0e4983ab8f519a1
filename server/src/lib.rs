//! The gleaner server: storage, jobs, scores, policies, behind gRPC.
