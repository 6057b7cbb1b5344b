defmodule Situ.Bridge.Mqtt.Properties do
  @moduledoc false
  # The properties of MQTT 5 packets, as a map with the names of this table. Unknown properties are an error, because
  # their length is unknown. Properties that the standard allows only once are rejected if they are repeated. Pure.
  import Bitwise

  @type t :: %{atom() => term()}

  @table [
    {0x01, :payload_format, :byte},
    {0x02, :message_expiry, :four_bytes},
    {0x03, :content_type, :text},
    {0x08, :response_topic, :text},
    {0x09, :correlation_data, :bytes},
    {0x0B, :subscription_identifiers, :variable},
    {0x11, :session_expiry, :four_bytes},
    {0x12, :assigned_client, :text},
    {0x13, :server_keep_alive, :two_bytes},
    {0x15, :authentication_method, :text},
    {0x16, :authentication_data, :bytes},
    {0x17, :request_problem_information, :byte},
    {0x18, :will_delay, :four_bytes},
    {0x19, :request_response_information, :byte},
    {0x1A, :response_information, :text},
    {0x1C, :server_reference, :text},
    {0x1F, :reason_string, :text},
    {0x21, :receive_maximum, :two_bytes},
    {0x22, :topic_alias_maximum, :two_bytes},
    {0x23, :topic_alias, :two_bytes},
    {0x24, :maximum_qos, :byte},
    {0x25, :retain_available, :byte},
    {0x26, :user_properties, :pair},
    {0x27, :maximum_packet_size, :four_bytes},
    {0x28, :wildcards_available, :byte},
    {0x29, :subscription_identifiers_available, :byte},
    {0x2A, :shared_subscriptions_available, :byte}
  ]
  @by_id Map.new(@table, fn {id, name, kind} -> {id, {name, kind}} end)
  @by_name Map.new(@table, fn {id, name, kind} -> {name, {id, kind}} end)
  @repeatable [:user_properties, :subscription_identifiers]

  @doc "Encodes properties with their length; `nil` values are left out."
  @spec encode(Enumerable.t()) :: iodata()
  def encode(properties) do
    body = for {name, value} <- properties, value != nil, do: encode_property(name, value)
    [encode_variable(IO.iodata_length(body)), body]
  end

  defp encode_property(name, values) when name in @repeatable,
    do: for(value <- values, do: encode_single(name, value))

  defp encode_property(name, value), do: encode_single(name, value)

  defp encode_single(name, value) do
    {id, kind} = Map.fetch!(@by_name, name)
    [id, encode_value(kind, value)]
  end

  defp encode_value(:byte, n), do: <<n>>
  defp encode_value(:two_bytes, n), do: <<n::16>>
  defp encode_value(:four_bytes, n), do: <<n::32>>
  defp encode_value(:variable, n), do: encode_variable(n)
  defp encode_value(:pair, {key, value}), do: [encode_text(key), encode_text(value)]
  defp encode_value(_text_or_bytes, text), do: encode_text(text)

  @doc "Encodes a text or bytes with a length of two bytes."
  @spec encode_text(binary()) :: iodata()
  def encode_text(text), do: [<<byte_size(text)::16>>, text]

  @doc "Encodes a length of one to four bytes."
  @spec encode_variable(non_neg_integer()) :: iodata()
  def encode_variable(n) when n < 128, do: <<n>>
  def encode_variable(n), do: [<<1::1, n::7>>, encode_variable(n >>> 7)]

  @doc """
  Parses a length of one to four bytes.

      iex> Situ.Bridge.Mqtt.Properties.parse_variable(<<0xC8, 1, 7>>)
      {:ok, 200, <<7>>}
  """
  @spec parse_variable(binary()) :: {:ok, non_neg_integer(), binary()} | :more | :error
  def parse_variable(bytes), do: parse_variable(bytes, 0, 0)

  defp parse_variable(_bytes, 28, _sum), do: :error

  defp parse_variable(<<0::1, n::7, rest::binary>>, shift, sum),
    do: {:ok, sum ||| n <<< shift, rest}

  defp parse_variable(<<1::1, n::7, rest::binary>>, shift, sum),
    do: parse_variable(rest, shift + 7, sum ||| n <<< shift)

  defp parse_variable("", _shift, _sum), do: :more

  @doc "Parses properties; no bytes mean no properties."
  @spec parse(binary()) :: {:ok, t(), rest :: binary()} | :error
  def parse(""), do: {:ok, %{}, ""}

  def parse(bytes) do
    with {:ok, size, rest} when size <= byte_size(rest) <- parse_variable(bytes),
         <<body::binary-size(size), rest::binary>> = rest,
         %{} = properties <- parse_properties(body, %{}) do
      {:ok, restore_order(properties), rest}
    else
      _ -> :error
    end
  end

  defp restore_order(properties) do
    Map.new(properties, fn
      {name, values} when name in @repeatable -> {name, Enum.reverse(values)}
      property -> property
    end)
  end

  defp parse_properties("", properties), do: properties

  defp parse_properties(<<id, bytes::binary>>, properties) do
    with {name, kind} <- @by_id[id],
         {value, rest} <- parse_value(kind, bytes),
         %{} = properties <- put_property(properties, name, value),
         do: parse_properties(rest, properties),
         else: (_ -> :error)
  end

  defp put_property(properties, name, value) when name in @repeatable,
    do: Map.update(properties, name, [value], &[value | &1])

  defp put_property(properties, name, _value) when is_map_key(properties, name), do: :error
  defp put_property(properties, name, value), do: Map.put(properties, name, value)

  defp parse_value(:byte, <<n, rest::binary>>), do: {n, rest}
  defp parse_value(:two_bytes, <<n::16, rest::binary>>), do: {n, rest}
  defp parse_value(:four_bytes, <<n::32, rest::binary>>), do: {n, rest}

  defp parse_value(:variable, bytes) do
    case parse_variable(bytes) do
      {:ok, n, rest} -> {n, rest}
      _ -> :error
    end
  end

  defp parse_value(:pair, bytes) do
    with {key, rest} <- parse_value(:text, bytes),
         {value, rest} <- parse_value(:text, rest),
         do: {{key, value}, rest}
  end

  defp parse_value(:bytes, <<n::16, value::binary-size(n), rest::binary>>),
    do: {:binary.copy(value), rest}

  defp parse_value(:text, <<n::16, text::binary-size(n), rest::binary>>),
    do: if(String.valid?(text), do: {:binary.copy(text), rest}, else: :error)

  defp parse_value(_kind, _bytes), do: :error
end
