defmodule Situ.Bridge.Mqtt.Wire do
  @moduledoc false
  # The MQTT 3.1.1 packets that a client needs. Pure.
  #
  # A client needs only ten kinds of packets, so it is written here. The MQTT gateway of NATS
  # would force users who already have a broker to bridge it to NATS. There is no QoS 2: with QoS
  # 1 a message may arrive twice, and the second one is dropped because its time does not
  # increase.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise

  @type packet ::
          {:connack, code :: byte()}
          | {:publish, topic :: String.t(), payload :: binary(), qos :: 0..3, id :: 0..65_535}
          | {:puback, id :: 0..65_535}
          | {:suback, codes :: binary()}
          | :pong
          | {:other, 0..15}

  @doc "Encodes a client's first packet. With `session:`, the broker keeps messages while the client is offline."
  @spec encode_connect(keyword()) :: iodata()
  def encode_connect(opts) do
    clean = if opts[:session], do: 0, else: 2
    user = if opts[:username], do: 0x80, else: 0
    password = read_password(opts[:password])
    password_flag = if password, do: 0x40, else: 0
    texts = for text <- [opts[:username], password], text, do: encode_string(text)
    # Keep-alive is off, so no packets are sent merely to keep the connection open.
    encode_packet(1, 0, [
      encode_string("MQTT"),
      4,
      clean ||| user ||| password_flag,
      <<0::16>>,
      encode_string(opts[:id]) | texts
    ])
  end

  defp read_password(password) when is_function(password, 0), do: password.()
  defp read_password(password), do: password

  @spec encode_subscribe(1..65_535, String.t(), 0..1) :: iodata()
  def encode_subscribe(id, filter, qos),
    do: encode_packet(8, 2, [<<id::16>>, encode_string(filter), qos])

  @spec encode_publish(String.t(), iodata(), keyword()) :: iodata()
  def encode_publish(topic, payload, opts) do
    flags = (opts[:qos] || 0) <<< 1 ||| if(opts[:retain], do: 1, else: 0)
    flags = if opts[:duplicate], do: flags ||| 8, else: flags
    id = if opts[:qos] == 1, do: <<opts[:id]::16>>, else: ""
    encode_packet(3, flags, [encode_string(topic), id, payload])
  end

  @spec encode_puback(0..65_535) :: iodata()
  def encode_puback(id), do: encode_packet(4, 0, <<id::16>>)

  @spec encode_disconnect() :: iodata()
  def encode_disconnect, do: encode_packet(14, 0, "")

  defp encode_string(text), do: [<<byte_size(text)::16>>, text]

  defp encode_packet(kind, flags, body),
    do: [<<kind::4, flags::4>>, encode_length(IO.iodata_length(body)), body]

  defp encode_length(n) when n < 128, do: <<n>>
  defp encode_length(n), do: [<<1::1, n::7>>, encode_length(n >>> 7)]

  @doc "Parses the first packet in `bytes`; a packet longer than `max` is an error."
  @spec parse_packet(binary(), pos_integer()) ::
          {:ok, packet(), rest :: binary()} | :more | {:error, String.t()}
  def parse_packet(<<kind::4, flags::4, rest::binary>>, max) do
    case parse_length(rest, 0, 0) do
      {n, _} when n > max -> {:error, "a packet of #{n} bytes exceeds the limit"}
      {n, rest} when byte_size(rest) < n -> :more
      {n, rest} -> split_packet(kind, flags, n, rest)
      other -> other
    end
  end

  def parse_packet("", _max), do: :more

  @doc "Returns the minimum number of bytes that an incomplete packet lacks."
  @spec missing_bytes(binary()) :: pos_integer()
  def missing_bytes(<<_, rest::binary>>) do
    case parse_length(rest, 0, 0) do
      {n, rest} when is_integer(n) and n > byte_size(rest) -> n - byte_size(rest)
      _ -> 1
    end
  end

  def missing_bytes(""), do: 1

  defp parse_length(_bytes, 28, _sum), do: {:error, "a packet with an invalid length"}

  defp parse_length(<<0::1, n::7, rest::binary>>, shift, sum), do: {sum ||| n <<< shift, rest}

  defp parse_length(<<1::1, n::7, rest::binary>>, shift, sum),
    do: parse_length(rest, shift + 7, sum ||| n <<< shift)

  defp parse_length("", _shift, _sum), do: :more

  defp split_packet(kind, flags, n, bytes) do
    <<body::binary-pinned_size(n), rest::binary>> = bytes

    case parse_body(kind, flags, body) do
      :error -> {:error, "an invalid packet of type #{kind}"}
      packet -> {:ok, packet, rest}
    end
  end

  defp parse_body(2, _flags, <<_, code>>), do: {:connack, code}
  defp parse_body(4, _flags, <<id::16>>), do: {:puback, id}
  defp parse_body(9, _flags, <<_id::16, codes::binary>>), do: {:suback, codes}
  defp parse_body(13, _flags, ""), do: :pong

  defp parse_body(3, flags, <<n::16, topic::binary-size(n), rest::binary>>) do
    case {flags >>> 1 &&& 3, rest} do
      {0, payload} -> {:publish, topic, :binary.copy(payload), 0, 0}
      {3, _} -> :error
      {qos, <<id::16, payload::binary>>} -> {:publish, topic, :binary.copy(payload), qos, id}
      _ -> :error
    end
  end

  defp parse_body(kind, _flags, _body) when kind in [2, 3, 4, 9, 13], do: :error
  defp parse_body(kind, _flags, _body), do: {:other, kind}

  @refusals %{
    1 => "it does not support MQTT 3.1.1",
    2 => "it rejects the client identifier",
    3 => "it is not available",
    4 => "the user name or the password is wrong",
    5 => "this user is not authorized"
  }

  @doc "Describes why a broker refused a connection."
  @spec describe_refusal(byte()) :: String.t()
  def describe_refusal(code),
    do: Map.get(@refusals, code, "it refuses the connection with code #{code}")
end
