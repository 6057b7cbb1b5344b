defmodule Situ.Remote.Link.Handshake do
  @moduledoc """
  Authenticates both sides of a link: each sends its version and a nonce, then proves that it knows the token. Pure.

  The token is never sent. A proof is the HMAC-SHA256 of the prover's role and both nonces under the token, so an
  eavesdropper cannot reuse it, and a client detects a server that does not know the token.

  Each side announces the newest and the oldest version it supports. The link uses the older of the two newest versions.

      iex> alias Situ.Remote.Link.Handshake
      iex> {ours, theirs} = {Handshake.nonce(), Handshake.nonce()}
      iex> proof = Handshake.proof("secret", :client, ours, theirs)
      iex> Handshake.proves?("secret", :client, ours, theirs, proof)
      true
      iex> Handshake.proves?("Secret", :client, ours, theirs, proof)
      false
      iex> Handshake.agree({3, 2}, {5, 3})
      {:ok, 3}
      iex> Handshake.agree({1, 1}, {5, 2})
      :error
  """
  alias Situ.Error
  alias Situ.Remote.Link.Frame

  @oldest 1

  @type role :: :client | :server

  @doc "Builds the greeting of one side."
  @spec hello(binary()) :: Frame.t()
  def hello(nonce), do: {:hello, Frame.version(), @oldest, nonce}

  @spec nonce() :: binary()
  def nonce, do: :crypto.strong_rand_bytes(16)

  @doc "Returns the newest version that both `{newest, oldest}` ranges include."
  @spec agree({integer(), integer()}, {integer(), integer()}) :: {:ok, integer()} | :error
  def agree({ours, our_oldest}, {theirs, their_oldest}) do
    version = min(ours, theirs)
    if version >= max(our_oldest, their_oldest), do: {:ok, version}, else: :error
  end

  @doc "Checks the remote versions against this release, as `agree/2` does. The error names the versions of both sides."
  @spec check_version(integer(), integer()) :: {:ok, integer()} | {:error, Error.t()}
  def check_version(theirs, their_oldest) do
    with :error <- agree({Frame.version(), @oldest}, {theirs, their_oldest}) do
      {:error,
       Error.new(:wrong_version, "the two sides of the link speak different versions",
         why:
           "this side supports #{@oldest} to #{Frame.version()}, the other side #{their_oldest} to #{theirs}",
         fix: "install the same release of Situ on both sides"
       )}
    end
  end

  @typedoc "A token, or a function that returns it. Processes store the function, so that logs do not show the token."
  @type token :: String.t() | (() -> String.t())

  @doc "Wraps a token in a function, so that inspecting a term does not print it."
  @spec hide(token()) :: token()
  def hide(token) when is_binary(token), do: fn -> token end
  def hide(token) when is_function(token, 0), do: token

  @doc "Builds the proof that `role` knows the token."
  @spec proof(token(), role(), server_nonce :: binary(), client_nonce :: binary()) :: binary()
  def proof(token, role, server_nonce, client_nonce) when is_function(token, 0),
    do: proof(token.(), role, server_nonce, client_nonce)

  def proof(token, role, server_nonce, client_nonce),
    do: :crypto.mac(:hmac, :sha256, token, ["situ-link-#{role}", server_nonce, client_nonce])

  @spec proves?(token(), role(), binary(), binary(), binary()) :: boolean()
  def proves?(token, role, server_nonce, client_nonce, shown),
    do: :crypto.hash_equals(proof(token, role, server_nonce, client_nonce), shown)

  @doc "Converts an error to the map that a `:refused` frame carries."
  @spec to_map(Error.t()) :: map()
  def to_map(%Error{} = error) do
    %{
      "code" => to_string(error.code),
      "what" => error.what,
      "why" => error.why,
      "fix" => error.fix
    }
  end

  @codes %{
    "wrong_version" => :wrong_version,
    "wrong_token" => :wrong_token,
    "too_many_clients" => :too_many_clients,
    "no_recording" => :no_recording,
    "bad_frame" => :bad_frame,
    "bad_request" => :bad_request,
    "no_stream" => :no_stream,
    "no_store" => :no_store,
    "no_summary" => :no_summary,
    "damaged" => :damaged,
    "checksum" => :checksum,
    "server_closed" => :server_closed
  }

  @spec from_map(map()) :: Error.t()
  def from_map(map) do
    code = Map.get(@codes, map["code"], :refused)

    Error.new(code, text(map["what"]) || "the server refused",
      why: text(map["why"]),
      fix: text(map["fix"])
    )
  end

  defp text(text) when is_binary(text), do: String.slice(text, 0, 500)
  defp text(_), do: nil
end
