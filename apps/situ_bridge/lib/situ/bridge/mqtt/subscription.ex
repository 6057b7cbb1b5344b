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
  def read(bytes, said, most), do: read_packets(said <> bytes, most, [], [])

  @impl true
  defdelegate missing(said), to: Wire, as: :missing_bytes

  defp read_packets(bytes, most, payloads, answers) do
    case Wire.parse_packet(bytes, most) do
      {:ok, {:publish, _topic, payload, 0, _}, rest} ->
        read_packets(rest, most, [payload | payloads], answers)

      {:ok, {:publish, _topic, payload, _qos, id}, rest} ->
        read_packets(rest, most, [payload | payloads], [answers, Wire.encode_puback(id)])

      {:ok, {:connack, code}, _rest} when code != 0 ->
        {:error, "the broker: " <> Wire.describe_refusal(code)}

      {:ok, {:suback, <<0x80>>}, _rest} ->
        {:error, "the broker refuses the subscription"}

      {:ok, _other, rest} ->
        read_packets(rest, most, payloads, answers)

      :more ->
        {:ok, Enum.reverse(payloads), IO.iodata_to_binary(answers), bytes}

      {:error, why} ->
        {:error, why}
    end
  end
end
