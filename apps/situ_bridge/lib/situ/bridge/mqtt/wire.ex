defmodule Situ.Bridge.Mqtt.Wire do
  @moduledoc false
  # The packets of MQTT 5 and 3.1.1 that a client needs. `version` is the protocol level: 5, or 4 for MQTT 3.1.1. Why it
  # is our own: ADR 0210. Pure.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise
  alias Situ.Bridge.Mqtt.Properties

  @type version :: 4 | 5
  @type publication :: %{
          topic: String.t(),
          payload: binary(),
          qos: 0..2,
          id: 0..65_535,
          retain?: boolean(),
          properties: Properties.t()
        }
  @type acknowledgement :: :puback | :pubrec | :pubrel | :pubcomp
  @type packet ::
          {:connack, session_present? :: boolean(), code :: byte(), Properties.t()}
          | {:publish, publication()}
          | {acknowledgement(), id :: 0..65_535, code :: byte(), Properties.t()}
          | {:suback, codes :: binary(), Properties.t()}
          | {:disconnect, code :: byte(), Properties.t()}
          | :pong
          | {:other, 0..15}

  @acknowledgements %{puback: {4, 0}, pubrec: {5, 0}, pubrel: {6, 2}, pubcomp: {7, 0}}
  @acknowledgement_kinds Map.new(@acknowledgements, fn {name, {kind, _}} -> {kind, name} end)

  @doc """
  Encodes a client's first packet. `opts` are `id`, `version`, `clean` (the broker forgets an earlier session),
  `keep_alive` (s, by default off), `username`, `password`, `will` (see `Situ.Bridge.Mqtt`) and `properties`.
  """
  @spec encode_connect(keyword()) :: iodata()
  def encode_connect(opts) do
    version = opts[:version] || 4
    clean = if Keyword.get(opts, :clean, true), do: 2, else: 0
    user = if opts[:username], do: 0x80, else: 0
    password = read_password(opts[:password])
    password_flag = if password, do: 0x40, else: 0
    {will_flags, will} = encode_will(opts[:will], version)
    texts = for text <- [opts[:username], password], text, do: encode_text(text)

    encode_packet(1, 0, [
      encode_text("MQTT"),
      version,
      clean ||| user ||| password_flag ||| will_flags,
      <<opts[:keep_alive] || 0::16>>,
      encode_properties(opts[:properties] || [], version),
      encode_text(opts[:id]),
      will | texts
    ])
  end

  defp read_password(password) when is_function(password, 0), do: password.()
  defp read_password(password), do: password

  defp encode_will(nil, _version), do: {0, ""}

  defp encode_will(will, version) do
    retain = if will[:retain], do: 0x20, else: 0
    properties = [will_delay: will[:delay], content_type: will[:content_type]]

    {4 ||| (will[:qos] || 0) <<< 3 ||| retain,
     [
       encode_properties(properties, version),
       encode_text(will[:topic]),
       encode_text(will[:payload] || "")
     ]}
  end

  @doc """
  Encodes a subscription. `opts` are `version`, `qos`, and with MQTT 5 `no_local`, `retain_as_published` and
  `retain_handling` (0: retained messages are sent, 1: only for a new subscription, 2: never).
  """
  @spec encode_subscribe(1..65_535, String.t(), keyword()) :: iodata()
  def encode_subscribe(id, filter, opts) do
    version = opts[:version] || 4

    flags =
      if version == 5 do
        no_local = if opts[:no_local], do: 4, else: 0
        as_published = if opts[:retain_as_published], do: 8, else: 0
        no_local ||| as_published ||| (opts[:retain_handling] || 0) <<< 4
      else
        0
      end

    options = flags ||| (opts[:qos] || 0)

    encode_packet(8, 2, [<<id::16>>, encode_properties([], version), encode_text(filter), options])
  end

  @doc "Encodes a message. `opts` are `version`, `qos`, `id`, `retain`, `duplicate` and `properties`."
  @spec encode_publish(String.t(), iodata(), keyword()) :: iodata()
  def encode_publish(topic, payload, opts) do
    qos = opts[:qos] || 0
    flags = qos <<< 1 ||| if(opts[:retain], do: 1, else: 0)
    flags = if opts[:duplicate], do: flags ||| 8, else: flags
    id = if qos > 0, do: <<opts[:id]::16>>, else: ""
    properties = encode_properties(opts[:properties] || [], opts[:version] || 4)
    encode_packet(3, flags, [encode_text(topic), id, properties, payload])
  end

  @doc "Encodes a successful acknowledgement, which is the same in both versions."
  @spec encode_acknowledgement(acknowledgement(), 0..65_535) :: iodata()
  def encode_acknowledgement(name, id) do
    {kind, flags} = Map.fetch!(@acknowledgements, name)
    encode_packet(kind, flags, <<id::16>>)
  end

  @doc "Encodes a ping; the broker replies to it."
  @spec encode_ping() :: iodata()
  def encode_ping, do: encode_packet(12, 0, "")

  @doc "Encodes the last packet. With MQTT 5, `properties` can end the session (`session_expiry: 0`)."
  @spec encode_disconnect(version(), keyword()) :: iodata()
  def encode_disconnect(version \\ 4, properties \\ [])

  def encode_disconnect(5, [_ | _] = properties),
    do: encode_packet(14, 0, [0, Properties.encode(properties)])

  def encode_disconnect(_version, _properties), do: encode_packet(14, 0, "")

  defdelegate encode_text(text), to: Properties

  defp encode_properties(properties, 5), do: Properties.encode(properties)
  defp encode_properties(_properties, 4), do: ""

  defp encode_packet(kind, flags, body),
    do: [<<kind::4, flags::4>>, Properties.encode_variable(IO.iodata_length(body)), body]

  @doc "Parses the first packet in `bytes`; a packet longer than `max` is an error."
  @spec parse_packet(binary(), pos_integer(), version()) ::
          {:ok, packet(), rest :: binary()} | :more | {:error, String.t()}
  def parse_packet("", _max, _version), do: :more

  def parse_packet(<<kind::4, flags::4, rest::binary>>, max, version) do
    case Properties.parse_variable(rest) do
      {:ok, n, _} when n > max -> {:error, "a packet of #{n} bytes exceeds the limit"}
      {:ok, n, rest} when byte_size(rest) < n -> :more
      {:ok, n, rest} -> split_packet({kind, flags}, n, rest, version)
      :more -> :more
      :error -> {:error, "a packet with an invalid length"}
    end
  end

  @doc "Returns the minimum number of bytes that an incomplete packet lacks."
  @spec missing_bytes(binary()) :: pos_integer()
  def missing_bytes(""), do: 1

  def missing_bytes(<<_, rest::binary>>) do
    case Properties.parse_variable(rest) do
      {:ok, n, rest} when n > byte_size(rest) -> n - byte_size(rest)
      _ -> 1
    end
  end

  defp split_packet({kind, flags}, n, bytes, version) do
    <<body::binary-pinned_size(n), rest::binary>> = bytes

    case parse_body(kind, flags, body, version) do
      :error -> {:error, "an invalid packet of type #{kind}"}
      packet -> {:ok, packet, rest}
    end
  end

  # A broker without MQTT 5 refuses it with the CONNACK of MQTT 3.1.1.
  defp parse_body(2, _flags, <<_::7, present::1, code>>, _version),
    do: {:connack, present == 1, code, %{}}

  defp parse_body(2, _flags, <<_::7, present::1, code, rest::binary>>, 5) do
    case Properties.parse(rest) do
      {:ok, properties, ""} -> {:connack, present == 1, code, properties}
      _ -> :error
    end
  end

  defp parse_body(3, flags, <<n::16, topic::binary-size(n), rest::binary>>, version) do
    with true <- String.valid?(topic),
         qos when qos < 3 <- flags >>> 1 &&& 3,
         {id, rest} <- parse_id(qos, rest),
         {:ok, properties, payload} <- parse_properties(rest, version) do
      {:publish,
       %{
         topic: :binary.copy(topic),
         payload: :binary.copy(payload),
         qos: qos,
         id: id,
         retain?: (flags &&& 1) == 1,
         properties: properties
       }}
    else
      _ -> :error
    end
  end

  defp parse_body(kind, _flags, <<id::16, rest::binary>>, version)
       when is_map_key(@acknowledgement_kinds, kind) do
    with {:ok, code, properties} <- parse_reason(rest, version),
         do: {@acknowledgement_kinds[kind], id, code, properties}
  end

  defp parse_body(9, _flags, <<_id::16, rest::binary>>, version) do
    case parse_properties(rest, version) do
      {:ok, properties, <<_, _::binary>> = codes} -> {:suback, codes, properties}
      _ -> :error
    end
  end

  defp parse_body(13, _flags, "", _version), do: :pong

  defp parse_body(14, _flags, body, 5) do
    with {:ok, code, properties} <- parse_reason(body, 5), do: {:disconnect, code, properties}
  end

  defp parse_body(kind, _flags, _body, _version)
       when kind in [2, 3, 4, 5, 6, 7, 9, 13],
       do: :error

  defp parse_body(kind, _flags, _body, _version), do: {:other, kind}

  defp parse_id(0, rest), do: {0, rest}
  defp parse_id(_qos, <<id::16, rest::binary>>) when id > 0, do: {id, rest}
  defp parse_id(_qos, _rest), do: :error

  defp parse_properties(<<>>, 5), do: :error
  defp parse_properties(bytes, 5), do: Properties.parse(bytes)
  defp parse_properties(bytes, 4), do: {:ok, %{}, bytes}

  defp parse_reason("", _version), do: {:ok, 0, %{}}

  defp parse_reason(<<code, rest::binary>>, 5) do
    case Properties.parse(rest) do
      {:ok, properties, ""} -> {:ok, code, properties}
      _ -> :error
    end
  end

  defp parse_reason(_bytes, 4), do: :error
end
