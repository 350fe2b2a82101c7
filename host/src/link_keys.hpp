#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace fiona::host {

/// Length of a group's key, of a link's key and of a proof, and of the numbers that make each proof a new one.
inline constexpr std::size_t kKeyBytes = 32;
inline constexpr std::size_t kNonceBytes = 16;

/// What a process is given by its host.
struct LinkKeys {
  std::string own;       ///< what its peers must prove to know
  std::string memory{};  ///< with whoever knows it, too, it shares memory; empty: with nobody
};

/// Bytes nobody can guess.
std::string random_bytes(std::size_t count);
/// The key of the links from `client` to the process that has `provider_key`: that process makes it from the name that
/// a client gives; the client has it from the host, who knows all keys.
std::string link_key(const std::string& provider_key, std::string_view client);
/// What is proved to know of a host's memory key over one link, so that a proof cannot be passed on over another.
std::string memory_key(const std::string& host_key, const std::string& link_key);

enum class LinkSide { Client, Provider };
/// Shows knowledge of the key to whoever chose one of the two nonces: keyed BLAKE2b over side and nonces.
std::string link_proof(const std::string& link_key, LinkSide side, std::string_view client_nonce,
                       std::string_view provider_nonce);
/// Whether they are equal, in a time that does not tell where they differ.
bool same_proof(std::string_view a, std::string_view b);
/// A nonce that `secret` alone can make again from `of`, so that nothing is kept for a peer that has proved nothing.
std::string derived_nonce(const std::string& secret, std::string_view of);

}  // namespace fiona::host
