// The process groups of libtorch, and its switch of TF32, behind C functions. Each returns 0, or 1 with the reason in `message`, because no
// exception may cross into Rust. src/bindings.rs has the same declarations.
#include <ATen/Context.h>
#include <torch/csrc/distributed/c10d/PrefixStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>
#ifdef USE_C10D_NCCL
#include <torch/csrc/distributed/c10d/ProcessGroupNCCL.hpp>
#endif

#include <algorithm>
#include <cstring>

using Milliseconds = std::chrono::milliseconds;

#ifdef GLEANER_CUDA
// Of libtorch_cuda.so, in the declaration of ATen/cuda/CUDAContextLight.h, which needs CUDA's headers.
namespace at::cuda {
int warp_size();
}
#endif

struct gleaner_store {
  c10::intrusive_ptr<c10d::TCPStore> store;
};

struct gleaner_group {
  c10::intrusive_ptr<c10d::Backend> backend;
  // Whether the tensors of a GPU are summed there.
  bool on_gpu;
};

template <typename Act>
static int guarded(char *message, size_t room, Act act) {
  const char *reason = "an exception without a message";
  try {
    act();
    return 0;
  } catch (const std::exception &error) {
    std::strncpy(message, error.what(), room - 1);
  } catch (...) {
    std::strncpy(message, reason, room - 1);
  }
  message[room - 1] = 0;
  return 1;
}

// Runs a collective operation on the tensor, by way of main memory where the group cannot read a GPU's.
template <typename Collective>
static void over(gleaner_group *group, at::Tensor *tensor, Collective collective) {
  const bool staged = tensor->is_cuda() && !group->on_gpu;
  std::vector<at::Tensor> tensors{staged ? tensor->cpu() : *tensor};
  collective(tensors)->wait();
  if (staged) {
    tensor->copy_(tensors[0]);
  }
}

extern "C" {

// Whether this build can sum on GPUs.
int gleaner_group_has_nccl() {
#ifdef USE_C10D_NCCL
  return 1;
#else
  return 0;
#endif
}

// The store by which ranks find each other: rank 0 serves it at `*port` (0: any, written there), the others connect.
int gleaner_store_open(const char *host, uint16_t *port, int serves, int ranks, int64_t timeout_ms, gleaner_store **out,
                       char *message, size_t room) {
  return guarded(message, room, [&] {
    c10d::TCPStoreOptions options;
    options.port = *port;
    options.isServer = serves != 0;
    options.numWorkers = ranks;
    // Rank 0 reports its port before the others can come.
    options.waitWorkers = false;
    options.timeout = Milliseconds(timeout_ms);
    auto store = c10::make_intrusive<c10d::TCPStore>(host, options);
    *port = store->getPort();
    *out = new gleaner_store{store};
  });
}

// Writes a value for the other ranks.
int gleaner_store_set(gleaner_store *store, const char *key, const char *value, char *message, size_t room) {
  return guarded(message, room, [&] { static_cast<c10d::Store &>(*store->store).set(key, std::string(value)); });
}

// Waits for a value of this key; `*same` is whether it is `value`.
int gleaner_store_compare(gleaner_store *store, const char *key, const char *value, int64_t timeout_ms, int *same,
                          char *message, size_t room) {
  return guarded(message, room, [&] {
    store->store->wait({key}, Milliseconds(timeout_ms));
    *same = store->store->get_to_str(key) == value;
  });
}

// Joins the group of this name; the other ranks reach this one at `address`. Returns when all have joined.
int gleaner_group_join(gleaner_store *store, const char *name, int rank, int ranks, const char *address, int gpu,
                       int64_t timeout_ms, gleaner_group **out, char *message, size_t room) {
  return guarded(message, room, [&] {
    auto named = c10::make_intrusive<c10d::PrefixStore>(name, store->store);
#ifdef USE_C10D_NCCL
    if (gpu) {
      // The header's `Options` contain a struct that grows with NCCL's versions, and libtorch fills in its own.
      const auto found = torch::cuda::nccl::version();
      const auto major = found >> 32, minor = found >> 16 & 0xffff;
      TORCH_CHECK(major == NCCL_MAJOR && minor == NCCL_MINOR, "this program was built with the header of NCCL ", NCCL_MAJOR,
                  ".", NCCL_MINOR, ", and libtorch has NCCL ", major, ".", minor);
      auto options = c10d::ProcessGroupNCCL::Options::create();
      options->timeout = Milliseconds(timeout_ms);
      *out = new gleaner_group{c10::make_intrusive<c10d::ProcessGroupNCCL>(named, rank, ranks, options), true};
      return;
    }
#else
    (void)gpu;
#endif
    auto options = c10d::ProcessGroupGloo::Options::create(Milliseconds(timeout_ms));
    // The default resolves the host's name, which Debian's /etc/hosts maps to 127.0.1.1.
    options->devices.push_back(c10d::ProcessGroupGloo::createDeviceForHostname(address));
    *out = new gleaner_group{c10::make_intrusive<c10d::ProcessGroupGloo>(named, rank, ranks, options), false};
  });
}

// The tensor of every rank becomes the sum of all. It must be contiguous.
int gleaner_group_sum(gleaner_group *group, void *tensor, char *message, size_t room) {
  return guarded(message, room, [&] {
    over(group, static_cast<at::Tensor *>(tensor),
         [&](std::vector<at::Tensor> &tensors) { return group->backend->allreduce(tensors); });
  });
}

// The tensor of every rank becomes that of rank 0. It must be contiguous.
int gleaner_group_broadcast(gleaner_group *group, void *tensor, char *message, size_t room) {
  return guarded(message, room, [&] {
    over(group, static_cast<at::Tensor *>(tensor),
         [&](std::vector<at::Tensor> &tensors) { return group->backend->broadcast(tensors); });
  });
}

// Sets whether a GPU may multiply f32 matrices, and convolve, in TF32.
int gleaner_tf32_allow(int allowed, char *message, size_t room) {
  return guarded(message, room, [&] {
#ifdef GLEANER_CUDA
    // libtorch finds GPUs only where libtorch_cuda.so is loaded, and the linker leaves out a library of which no name is
    // used. Every program that computes on a GPU calls this function.
    int (*volatile of_cuda)() = &at::cuda::warp_size;
    (void)of_cuda;
#endif
    at::globalContext().setAllowTF32CuBLAS(allowed != 0);
    at::globalContext().setAllowTF32CuDNN(allowed != 0);
  });
}

// Whether a GPU may do both in TF32.
int gleaner_tf32_allowed(int *allowed, char *message, size_t room) {
  return guarded(message, room, [&] {
    *allowed = at::globalContext().allowTF32CuBLAS() && at::globalContext().allowTF32CuDNN();
  });
}

void gleaner_group_leave(gleaner_group *group) { delete group; }
void gleaner_store_close(gleaner_store *store) { delete store; }
}
