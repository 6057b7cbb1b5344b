defmodule Situ.Cluster.Seal do
  @moduledoc false
  # Terms on their way through the log, signed with the cluster's cookie: whoever has the cookie may run code here
  # anyway, and nobody else can make a term that is decoded as it comes.
  alias Situ.Error

  @spec close(term()) :: binary()
  def close(term) do
    bytes = :erlang.term_to_binary(term)
    nonce = :crypto.strong_rand_bytes(16)
    <<nonce::binary, mac(nonce, bytes)::binary, bytes::binary>>
  end

  @spec open(binary()) :: {:ok, term()} | {:error, Error.t()}
  def open(<<nonce::binary-16, mac::binary-16, bytes::binary>>) do
    if :crypto.hash_equals(mac(nonce, bytes), mac),
      do: {:ok, :erlang.binary_to_term(bytes)},
      else: {:error, foreign()}
  end

  def open(_bytes), do: {:error, foreign()}

  defp foreign do
    Error.new(:wrong_cookie, "an entry of the log is not signed by this cluster",
      why: "it was written by nodes with another cookie, or changed",
      fix: "give all nodes the same cookie, or deploy under another name"
    )
  end

  # Poly1305 under a key that is used once: a seventh of what HMAC costs for a picture.
  defp mac(nonce, bytes),
    do: :crypto.mac(:poly1305, :crypto.mac(:hmac, :sha256, key(), nonce), bytes)

  defp key, do: :crypto.hash(:sha256, ["situ", Atom.to_string(Node.get_cookie())])
end
