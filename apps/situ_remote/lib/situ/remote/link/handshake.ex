defmodule Situ.Remote.Link.Handshake do
  @moduledoc """
  Who may talk: both sides say their version and a nonce, then each proves that it knows the token. Pure.

  The token never goes over the wire: a proof is the HMAC-SHA256 of the prover's role and both nonces under the token,
  so what somebody overhears is of no use later, and a client notices a server that does not know the token.

  Versions: each side says the newest and the oldest it speaks; the older of the two newest ones is spoken.

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

  @doc "The greeting of one side."
  @spec hello(binary()) :: Frame.t()
  def hello(nonce), do: {:hello, Frame.version(), @oldest, nonce}

  @spec nonce() :: binary()
  def nonce, do: :crypto.strong_rand_bytes(16)

  @doc "The newest version that both `{newest, oldest}` speak."
  @spec agree({integer(), integer()}, {integer(), integer()}) :: {:ok, integer()} | :error
  def agree({ours, our_oldest}, {theirs, their_oldest}) do
    version = min(ours, theirs)
    if version >= max(our_oldest, their_oldest), do: {:ok, version}, else: :error
  end

  @doc "As `agree/2` for what is spoken here; the error tells both sides' versions."
  @spec check_version(integer(), integer()) :: {:ok, integer()} | {:error, Error.t()}
  def check_version(theirs, their_oldest) do
    with :error <- agree({Frame.version(), @oldest}, {theirs, their_oldest}) do
      {:error,
       Error.new(:wrong_version, "the two sides of the link speak different versions",
         why:
           "here #{@oldest} to #{Frame.version()}, on the other side #{their_oldest} to #{theirs}",
         fix: "bring both to the same release of Situ"
       )}
    end
  end

  @typedoc "A token; where processes keep it, as a function, which no log and no `:sys.get_state/1` shows."
  @type token :: String.t() | (() -> String.t())

  @doc "Hides a token from whatever prints it."
  @spec hide(token()) :: token()
  def hide(token) when is_binary(token), do: fn -> token end
  def hide(token) when is_function(token, 0), do: token

  @doc "The proof of `role` that it knows the token."
  @spec proof(token(), role(), server_nonce :: binary(), client_nonce :: binary()) :: binary()
  def proof(token, role, server_nonce, client_nonce) when is_function(token, 0),
    do: proof(token.(), role, server_nonce, client_nonce)

  def proof(token, role, server_nonce, client_nonce),
    do: :crypto.mac(:hmac, :sha256, token, ["situ-link-#{role}", server_nonce, client_nonce])

  @spec proves?(token(), role(), binary(), binary(), binary()) :: boolean()
  def proves?(token, role, server_nonce, client_nonce, shown),
    do: :crypto.hash_equals(proof(token, role, server_nonce, client_nonce), shown)

  @doc "An error as what a refusal says, and back."
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
