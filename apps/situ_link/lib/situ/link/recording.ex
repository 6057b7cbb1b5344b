defmodule Situ.Link.Recording do
  @moduledoc false
  # Opens recordings on other machines like local ones. The documentation of `Situ.Link` describes their addresses and
  # options. Each request is sent when its result is needed, so only the requested data is transferred.
  # See docs/adr/0115-remote-recordings-answer-requests.md.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format
  alias Situ.{Error, Link}
  alias Situ.Link.{Access, Address}
  alias Situ.Link.Recording.{ReplyDecoder, Client}
  alias Situ.Store.StreamInfo

  @enforce_keys [:address, :access]
  defstruct [:address, :access, :version]

  @typedoc "The address, the token and TLS options, and the opened version of the recording."
  @type t :: %__MODULE__{address: Address.t(), access: Access.t(), version: integer() | nil}

  @impl true
  def extensions, do: []
  @impl true
  def schemes, do: ["situ", "situs", "situ+unix"]

  @impl true
  def open(text, opts) do
    with {:ok, address} <- Address.parse(text),
         {:ok, access} <- Access.new(address, opts),
         state = %__MODULE__{address: address, access: access},
         {:ok, info} <- fetch_decoded(state, %{"op" => "open"}, &ReplyDecoder.decode_info/1),
         do: {:ok, %{state | version: info[:version]}}
  end

  # The addresses of a server that does not respond are unknown.
  @impl true
  def list_recordings(text) do
    with {:error, _} <- Link.list_recordings(text), do: [], else: ({:ok, addresses} -> addresses)
  end

  @impl true
  def info(state),
    do: state |> fetch_decoded(%{"op" => "open"}, &ReplyDecoder.decode_info/1) |> Error.unwrap!()

  @impl true
  def streams(state) do
    state
    |> fetch_decoded(%{"op" => "streams"}, &ReplyDecoder.decode_streams(&1, address_text(state)))
    |> Error.unwrap!()
  end

  @impl true
  def stream(state, name) do
    request = %{"op" => "stream", "stream" => name}

    with {:ok, [info]} <-
           fetch_decoded(state, request, &ReplyDecoder.decode_streams(&1, address_text(state))),
         do: {:ok, info}
  end

  defp address_text(state), do: Address.to_string(state.address)

  @impl true
  def seek(state, info, time),
    do:
      request_stream(state, info, "seek", %{"time" => clamp(time)}, &ReplyDecoder.decode_number/1)

  @impl true
  def count(state, info),
    do:
      state
      |> request_stream(info, "count", %{}, &ReplyDecoder.decode_number/1)
      |> Error.unwrap!()

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    request = %{
      "ordinal" => ordinal,
      "to" => if(to == :unbounded, do: nil, else: clamp(to)),
      "limit" => limit,
      "exact" => opts[:exact] || false,
      "envelopes" => opts[:envelopes] || false,
      "skip_damage" => opts[:skip_damage] || false
    }

    with {:ok, {messages, next}} <-
           request_stream(
             state,
             info,
             "read",
             request,
             &ReplyDecoder.decode_messages(&1, info.id)
           ),
         do: {:ok, messages, next}
  end

  @impl true
  def summary(state, info, from, to, pixels) do
    request = %{"from" => clamp(from), "to" => clamp(to), "pixels" => pixels}

    with {:ok, {width, bins}} <-
           request_stream(state, info, "summary", request, &ReplyDecoder.decode_summary/1),
         do: {:ok, width, bins}
  end

  @impl true
  def tracks(state, info, from, to, level, max) do
    request = %{"from" => clamp(from), "to" => clamp(to), "level" => level, "most" => max}

    with {:ok, {counts, tracks}} <-
           request_stream(state, info, "tracks", request, &ReplyDecoder.decode_tracks/1),
         do: {:ok, counts, tracks}
  end

  @impl true
  def gaps(state, info, min) do
    state
    |> request_stream(info, "gaps", %{"least" => clamp(min)}, &ReplyDecoder.decode_spans/1)
    |> Error.unwrap!()
  end

  @impl true
  def missing_files(state),
    do:
      state
      |> fetch_decoded(%{"op" => "missing_files"}, &ReplyDecoder.decode_strings/1)
      |> Error.unwrap!()

  @impl true
  def notify(state, known, pid, tag) do
    request = %{"op" => "await", "known" => known, "version" => state.version}
    Client.await_notice(state.address, state.access, request, {pid, tag})
  end

  defp request_stream(state, %StreamInfo{name: name}, op, request, decode),
    do: fetch_decoded(state, Map.merge(request, %{"op" => op, "stream" => name}), decode)

  defp fetch_decoded(state, request, decode) do
    request = Map.put(request, "version", state.version)

    with {:ok, body} <- Client.fetch_reply(state.address, state.access, request),
         :error <- decode.(body) do
      {:error,
       Error.new(:bad_reply, "the reply from #{address_text(state)} is malformed",
         why: "the reply to #{request["op"]} does not have the form that this release expects",
         fix: "install the same release of Situ on both sides"
       )}
    end
  end

  defp clamp(time), do: time |> max(-0x7FFFFFFFFFFFFFFF) |> min(0x7FFFFFFFFFFFFFFF)
end
