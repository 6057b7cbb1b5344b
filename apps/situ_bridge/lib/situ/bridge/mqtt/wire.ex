defmodule Situ.Bridge.Mqtt.Wire do
  @moduledoc false
  # The MQTT 3.1.1 packets that a client needs. Pure.
  import Situ.Bits, only: [known: 1]
  import Bitwise

  @type packet ::
          {:connack, code :: byte()}
          | {:publish, topic :: String.t(), payload :: binary(), qos :: 0..3, id :: 0..65_535}
          | {:puback, id :: 0..65_535}
          | {:suback, codes :: binary()}
          | :pong
          | {:other, 0..15}

  @doc "Encodes a client's first packet. With `session:`, the broker keeps messages while the client is offline."
  @spec connect(keyword()) :: iodata()
  def connect(opts) do
    clean = if opts[:session], do: 0, else: 2
    user = if opts[:username], do: 0x80, else: 0
    password = read_password(opts[:password])
    password_flag = if password, do: 0x40, else: 0
    texts = for text <- [opts[:username], password], text, do: text(text)
    # Keep-alive is off: no packets are sent only to be acknowledged.
    packet(1, 0, [
      text("MQTT"),
      4,
      clean ||| user ||| password_flag,
      <<0::16>>,
      text(opts[:id]) | texts
    ])
  end

  defp read_password(password) when is_function(password, 0), do: password.()
  defp read_password(password), do: password

  @spec subscribe(1..65_535, String.t(), 0..1) :: iodata()
  def subscribe(id, filter, qos), do: packet(8, 2, [<<id::16>>, text(filter), qos])

  @spec publish(String.t(), iodata(), keyword()) :: iodata()
  def publish(topic, payload, opts) do
    flags = (opts[:qos] || 0) <<< 1 ||| if(opts[:retain], do: 1, else: 0)
    flags = if opts[:again], do: flags ||| 8, else: flags
    id = if opts[:qos] == 1, do: <<opts[:id]::16>>, else: ""
    packet(3, flags, [text(topic), id, payload])
  end

  @spec puback(0..65_535) :: iodata()
  def puback(id), do: packet(4, 0, <<id::16>>)

  @spec disconnect() :: iodata()
  def disconnect, do: packet(14, 0, "")

  defp text(text), do: [<<byte_size(text)::16>>, text]

  defp packet(kind, flags, body),
    do: [<<kind::4, flags::4>>, size(IO.iodata_length(body)), body]

  defp size(n) when n < 128, do: <<n>>
  defp size(n), do: [<<1::1, n::7>>, size(n >>> 7)]

  @doc "Parses the first packet in `bytes`; a packet longer than `most` is an error."
  @spec read(binary(), pos_integer()) ::
          {:ok, packet(), rest :: binary()} | :more | {:error, String.t()}
  def read(<<kind::4, flags::4, rest::binary>>, most) do
    case length(rest, 0, 0) do
      {n, _} when n > most -> {:error, "a packet of #{n} bytes exceeds the limit"}
      {n, rest} when byte_size(rest) < n -> :more
      {n, rest} -> taken(kind, flags, n, rest)
      other -> other
    end
  end

  def read("", _most), do: :more

  @doc "Returns the minimum number of bytes that an incomplete packet lacks."
  @spec missing(binary()) :: pos_integer()
  def missing(<<_, rest::binary>>) do
    case length(rest, 0, 0) do
      {n, rest} when is_integer(n) and n > byte_size(rest) -> n - byte_size(rest)
      _ -> 1
    end
  end

  def missing(""), do: 1

  defp length(_bytes, 28, _sum), do: {:error, "a packet with an invalid length"}

  defp length(<<0::1, n::7, rest::binary>>, shift, sum), do: {sum ||| n <<< shift, rest}

  defp length(<<1::1, n::7, rest::binary>>, shift, sum),
    do: length(rest, shift + 7, sum ||| n <<< shift)

  defp length("", _shift, _sum), do: :more

  defp taken(kind, flags, n, bytes) do
    <<body::binary-known(n), rest::binary>> = bytes

    case body(kind, flags, body) do
      :error -> {:error, "an invalid packet of type #{kind}"}
      packet -> {:ok, packet, rest}
    end
  end

  defp body(2, _flags, <<_, code>>), do: {:connack, code}
  defp body(4, _flags, <<id::16>>), do: {:puback, id}
  defp body(9, _flags, <<_id::16, codes::binary>>), do: {:suback, codes}
  defp body(13, _flags, ""), do: :pong

  defp body(3, flags, <<n::16, topic::binary-size(n), rest::binary>>) do
    case {flags >>> 1 &&& 3, rest} do
      {0, payload} -> {:publish, topic, :binary.copy(payload), 0, 0}
      {3, _} -> :error
      {qos, <<id::16, payload::binary>>} -> {:publish, topic, :binary.copy(payload), qos, id}
      _ -> :error
    end
  end

  defp body(kind, _flags, _body) when kind in [2, 3, 4, 9, 13], do: :error
  defp body(kind, _flags, _body), do: {:other, kind}

  @refusals %{
    1 => "it does not support MQTT 3.1.1",
    2 => "it rejects the client identifier",
    3 => "it is not available",
    4 => "the user name or the password is wrong",
    5 => "this user is not authorized"
  }

  @doc "Describes why a broker refused a connection."
  @spec refusal(byte()) :: String.t()
  def refusal(code), do: Map.get(@refusals, code, "it refuses the connection with code #{code}")
end
