defmodule Situ.Link.Wire.Handshake do
  @moduledoc false
  # Authenticates both sides of a link: each sends its version and a nonce, then proves that it
  # knows the token. Pure.
  #
  # The token is never sent. A proof is the HMAC-SHA256 of the prover's role and both nonces under
  # the token, so an eavesdropper cannot reuse it, and a client detects a server that does not
  # know the token.
  #
  # Each side announces the newest and the oldest version it supports. The link uses the older of
  # the two newest versions.
  alias Situ.Error
  alias Situ.Link.Wire.Frame

  @oldest 1

  @type role :: :client | :server

  @doc "Builds the greeting of one side."
  @spec build_hello(binary()) :: Frame.t()
  def build_hello(nonce), do: {:hello, Frame.protocol_version(), @oldest, nonce}

  @spec new_nonce() :: binary()
  def new_nonce, do: :crypto.strong_rand_bytes(16)

  @doc "Returns the newest version that both `{newest, oldest}` ranges include."
  @spec agree_version({integer(), integer()}, {integer(), integer()}) :: {:ok, integer()} | :error
  def agree_version({ours, our_oldest}, {theirs, their_oldest}) do
    version = min(ours, theirs)
    if version >= max(our_oldest, their_oldest), do: {:ok, version}, else: :error
  end

  @doc """
  Checks the remote versions against this release, as `agree_version/2` does. The error names the versions of both
  sides.
  """
  @spec check_version(integer(), integer()) :: {:ok, integer()} | {:error, Error.t()}
  def check_version(theirs, their_oldest) do
    with :error <- agree_version({Frame.protocol_version(), @oldest}, {theirs, their_oldest}) do
      {:error,
       Error.new(:wrong_version, "the two sides of the link speak different versions",
         why:
           "this side supports #{@oldest} to #{Frame.protocol_version()}, the other side #{their_oldest} to #{theirs}",
         fix: "install the same release of Situ on both sides"
       )}
    end
  end

  @typedoc "A token, or a function that returns it. Processes store the function, so that logs do not show the token."
  @type token :: String.t() | (() -> String.t())

  @doc "Wraps a token in a function, so that inspecting a term does not print it."
  @spec hide_token(token()) :: token()
  def hide_token(token) when is_binary(token), do: fn -> token end
  def hide_token(token) when is_function(token, 0), do: token

  @doc """
  Builds the proof that `role` knows the token.

      iex> alias Situ.Link.Wire.Handshake
      iex> {ours, theirs} = {Handshake.new_nonce(), Handshake.new_nonce()}
      iex> proof = Handshake.build_proof("secret", :client, ours, theirs)
      iex> Handshake.valid_proof?("secret", :client, ours, theirs, proof)
      true
      iex> Handshake.valid_proof?("Secret", :client, ours, theirs, proof)
      false
      iex> Handshake.agree_version({3, 2}, {5, 3})
      {:ok, 3}
      iex> Handshake.agree_version({1, 1}, {5, 2})
      :error
  """
  @spec build_proof(token(), role(), server_nonce :: binary(), client_nonce :: binary()) ::
          binary()
  def build_proof(token, role, server_nonce, client_nonce) when is_function(token, 0),
    do: build_proof(token.(), role, server_nonce, client_nonce)

  def build_proof(token, role, server_nonce, client_nonce),
    do: :crypto.mac(:hmac, :sha256, token, ["situ-link-#{role}", server_nonce, client_nonce])

  @spec valid_proof?(token(), role(), binary(), binary(), binary()) :: boolean()
  def valid_proof?(token, role, server_nonce, client_nonce, proof),
    do: :crypto.hash_equals(build_proof(token, role, server_nonce, client_nonce), proof)

  @doc "Converts an error to the map that a `:refused` frame carries."
  @spec error_to_map(Error.t()) :: map()
  def error_to_map(%Error{} = error) do
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

  @spec error_from_map(map()) :: Error.t()
  def error_from_map(fields) do
    code = Map.get(@codes, fields["code"], :refused)

    Error.new(code, truncate_text(fields["what"]) || "the server refused",
      why: truncate_text(fields["why"]),
      fix: truncate_text(fields["fix"])
    )
  end

  defp truncate_text(text) when is_binary(text), do: String.slice(text, 0, 500)
  defp truncate_text(_), do: nil
end
