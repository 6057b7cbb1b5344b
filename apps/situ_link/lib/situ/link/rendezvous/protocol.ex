defmodule Situ.Link.Rendezvous.Protocol do
  @moduledoc false
  # Encodes and decodes \psi's rendezvous protocol, version 2. Pure.
  #
  # Processes announce their endpoints. A process is `%{name: name, version: text, endpoints:
  # [endpoint]}`. An endpoint has one of these forms:
  #
  #   * `{:tcp, host, port, streams}`: one stream in \psi's TCP framing,
  #   * `{:address, address, streams}`: ZeroMQ in \psi, a link (`situ://...`) in Situ,
  #   * `{:exporter, host, port, transport, streams}`,
  #   * `{:clock, host, port, []}`.
  #
  # A stream is `{name, type}`, both strings. A string is its length (seven bits per byte, least
  # significant first) and its UTF-8 bytes. Integers are little-endian.
  import Situ.BinarySize, only: [pinned_size: 1]

  @version 2
  @max_text 4_096
  @max_endpoints 1_000
  @max_streams 10_000

  @type stream :: {name :: String.t(), type :: String.t()}
  @type endpoint ::
          {:tcp, String.t(), integer(), [stream()]}
          | {:address, String.t(), [stream()]}
          | {:exporter, String.t(), integer(), integer(), [stream()]}
          | {:clock, String.t(), integer(), [stream()]}
  @type process :: %{name: String.t(), version: String.t(), endpoints: [endpoint()]}
  @type update :: :disconnect | {:add, process()} | {:remove, String.t()}

  @spec protocol_version() :: 2
  def protocol_version, do: @version

  @spec encode(update()) :: iodata()
  def encode(:disconnect), do: <<0>>
  def encode({:remove, name}), do: [2, encode_text(name)]

  def encode({:add, %{name: name, version: version, endpoints: endpoints}}) do
    [
      1,
      encode_text(name),
      encode_text(version),
      encode_int(length(endpoints)) | Enum.map(endpoints, &encode_endpoint/1)
    ]
  end

  defp encode_endpoint({:tcp, host, port, streams}),
    do: [0, encode_text(host), encode_int(port) | encode_streams(streams)]

  defp encode_endpoint({:address, address, streams}),
    do: [1, encode_text(address) | encode_streams(streams)]

  defp encode_endpoint({:exporter, host, port, transport, streams}),
    do: [2, encode_text(host), encode_int(port), encode_int(transport) | encode_streams(streams)]

  defp encode_endpoint({:clock, host, port, streams}),
    do: [3, encode_text(host), encode_int(port) | encode_streams(streams)]

  defp encode_streams(streams),
    do: [
      encode_int(length(streams))
      | for({name, type} <- streams, do: [encode_text(name), encode_text(type)])
    ]

  defp encode_int(n), do: <<n::little-signed-32>>

  @doc "Encodes a string."
  @spec encode_text(String.t()) :: iodata()
  def encode_text(text), do: [encode_length(byte_size(text)), text]

  defp encode_length(n) when n < 128, do: <<n>>
  defp encode_length(n), do: <<1::1, rem(n, 128)::7, encode_length(div(n, 128))::binary>>

  @typedoc "Continues decoding an incomplete update with the bytes that arrive next."
  @type continuation :: (binary() -> result())
  @type result :: {:ok, update(), binary()} | {:more, continuation()} | {:error, String.t()}

  @doc """
  Decodes the first update in `bytes` and returns the remaining bytes, or `:more` if the update is
  incomplete.

      iex> alias Situ.Link.Rendezvous.Protocol
      iex> process = %{name: "robot", version: "1", endpoints: [{:address, "situ://r1/robot", [{"imu", ":float"}]}]}
      iex> bytes = IO.iodata_to_binary(Protocol.encode({:add, process}))
      iex> Protocol.decode(bytes <> "rest")
      {:ok, {:add, process}, "rest"}
      iex> Protocol.decode(binary_part(bytes, 0, 9))
      :more
      iex> Protocol.decode(<<7>>)
      {:error, "no update begins with the byte 7"}
  """
  @spec decode(binary()) :: {:ok, update(), binary()} | :more | {:error, String.t()}
  def decode(bytes) do
    with {:more, _continuation} <- feed(bytes), do: :more
  end

  @doc """
  Decodes an update that arrives in parts, as `decode/1` does. Only a string or number that was cut is read twice.

      iex> alias Situ.Link.Rendezvous.Protocol
      iex> <<first::binary-3, rest::binary>> = IO.iodata_to_binary(Protocol.encode({:remove, "robot"}))
      iex> {:more, continue} = Protocol.feed(first)
      iex> continue.(rest <> "next")
      {:ok, {:remove, "robot"}, "next"}
  """
  @spec feed(binary()) :: result()
  def feed(<<>>), do: {:more, &feed/1}
  def feed(<<0, rest::binary>>), do: {:ok, :disconnect, rest}

  def feed(<<1, rest::binary>>) do
    feed_text(rest, fn name, rest ->
      feed_text(rest, fn version, rest ->
        feed_list(rest, @max_endpoints, &feed_endpoint/2, fn endpoints, rest ->
          {:ok, {:add, %{name: name, version: version, endpoints: endpoints}}, rest}
        end)
      end)
    end)
  end

  def feed(<<2, rest::binary>>),
    do: feed_text(rest, fn name, rest -> {:ok, {:remove, name}, rest} end)

  def feed(<<kind, _::binary>>), do: {:error, "no update begins with the byte #{kind}"}

  # Each of these functions takes the bytes and a function `next`, which gets the value and the remaining bytes.

  defp feed_text(bytes, next), do: feed_one(bytes, &read_text/1, next)
  defp feed_int(bytes, next), do: feed_one(bytes, &read_int/1, next)

  defp feed_one(bytes, read, next) do
    case read.(bytes) do
      {:ok, value, rest} -> next.(value, rest)
      :more -> {:more, &feed_one(bytes <> &1, read, next)}
      {:error, why} -> {:error, why}
    end
  end

  defp feed_endpoint(<<kind, rest::binary>>, next) when kind in [0, 3] do
    feed_text(rest, fn host, rest ->
      feed_int(rest, fn port, rest ->
        feed_streams(rest, fn streams, rest ->
          next.({if(kind == 0, do: :tcp, else: :clock), host, port, streams}, rest)
        end)
      end)
    end)
  end

  defp feed_endpoint(<<1, rest::binary>>, next) do
    feed_text(rest, fn address, rest ->
      feed_streams(rest, fn streams, rest -> next.({:address, address, streams}, rest) end)
    end)
  end

  defp feed_endpoint(<<2, rest::binary>>, next) do
    feed_text(rest, fn host, rest ->
      feed_int(rest, fn port, rest ->
        feed_int(rest, fn transport, rest ->
          feed_streams(rest, &next.({:exporter, host, port, transport, &1}, &2))
        end)
      end)
    end)
  end

  defp feed_endpoint(<<kind, _::binary>>, _next),
    do: {:error, "unknown endpoint kind: #{kind}"}

  defp feed_endpoint(<<>>, next), do: {:more, &feed_endpoint(&1, next)}

  defp feed_streams(bytes, next), do: feed_list(bytes, @max_streams, &feed_stream/2, next)

  defp feed_stream(bytes, next) do
    feed_text(bytes, fn name, rest ->
      feed_text(rest, fn type, rest -> next.({name, type}, rest) end)
    end)
  end

  defp feed_list(bytes, max, item_parser, next) do
    feed_int(bytes, fn n, rest ->
      if n in 0..max,
        do: feed_n(rest, {n, []}, item_parser, next),
        else: {:error, "a list of #{n} items exceeds the limit"}
    end)
  end

  defp feed_n(rest, {0, items}, _one, next), do: next.(Enum.reverse(items), rest)

  defp feed_n(bytes, {n, items}, item_parser, next),
    do:
      item_parser.(bytes, fn item, rest ->
        feed_n(rest, {n - 1, [item | items]}, item_parser, next)
      end)

  @doc "Reads a 32-bit integer."
  @spec read_int(binary()) :: {:ok, integer(), binary()} | :more
  def read_int(<<n::little-signed-32, rest::binary>>), do: {:ok, n, rest}
  def read_int(_short), do: :more

  @doc "Reads a string, which must be UTF-8 and at most 4,096 bytes long."
  @spec read_text(binary()) :: {:ok, String.t(), binary()} | :more | {:error, String.t()}
  def read_text(<<0::1, n::7, rest::binary>>), do: take_text(n, rest)

  def read_text(<<1::1, low::7, 0::1, high::7, rest::binary>>),
    do: take_text(high * 128 + low, rest)

  def read_text(<<1::1, _::7, 1::1, _::7, _::binary>>),
    do: {:error, "a string is longer than 16 KiB"}

  def read_text(_short), do: :more

  defp take_text(n, _rest) when n > @max_text, do: {:error, "a string of #{n} bytes is too long"}

  defp take_text(n, bytes) do
    case bytes do
      <<text::binary-pinned_size(n), rest::binary>> ->
        if String.valid?(text),
          do: {:ok, text, rest},
          else: {:error, "a string is not valid UTF-8"}

      _ ->
        :more
    end
  end
end
