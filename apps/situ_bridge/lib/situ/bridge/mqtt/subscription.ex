defmodule Situ.Bridge.Mqtt.Subscription do
  @moduledoc false
  # A client with a single subscription. Pure.
  @behaviour Situ.Bridge.Net.Protocol
  alias Situ.Bridge.Mqtt.Wire

  # MQTT allows a client to subscribe before the broker has accepted its connection.
  @impl true
  def hello(_host, _port, arg),
    do: {[Wire.encode_connect(arg), Wire.encode_subscribe(1, arg[:topic], arg[:qos])], ""}

  @impl true
  def read(bytes, buffer, max), do: read_packets(buffer <> bytes, max, [], [])

  @impl true
  defdelegate missing_bytes(buffer), to: Wire

  defp read_packets(bytes, max, payloads, replies) do
    case Wire.parse_packet(bytes, max) do
      {:ok, {:publish, _topic, payload, 0, _}, rest} ->
        read_packets(rest, max, [payload | payloads], replies)

      {:ok, {:publish, _topic, payload, _qos, id}, rest} ->
        read_packets(rest, max, [payload | payloads], [replies, Wire.encode_puback(id)])

      {:ok, {:connack, code}, _rest} when code != 0 ->
        {:error, "the broker: " <> Wire.describe_refusal(code)}

      {:ok, {:suback, <<0x80>>}, _rest} ->
        {:error, "the broker refuses the subscription"}

      {:ok, _other, rest} ->
        read_packets(rest, max, payloads, replies)

      :more ->
        {:ok, Enum.reverse(payloads), IO.iodata_to_binary(replies), bytes}

      {:error, why} ->
        {:error, why}
    end
  end
end
