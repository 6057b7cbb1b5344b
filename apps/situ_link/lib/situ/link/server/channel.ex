defmodule Situ.Link.Server.Channel do
  @moduledoc false
  # Holds the server's state of one stream sent to one client: the request, its position, and the
  # remaining credit. Pure.
  alias Situ.Delivery
  alias Situ.Link.Wire.{Batch, DatagramCodec, Frame}

  @enforce_keys [:id, :name]
  defstruct [
    :id,
    :name,
    :from,
    :cursor,
    :policy,
    :udp,
    :datagrams,
    priority: 0,
    credit: 0,
    frames: [],
    sent: 0,
    dropped: 0,
    state: :waiting
  ]

  @typedoc """
  `state` is `:waiting` (no stream of this name exists yet), `:open`, or `:ended`. `frames` holds the frames to send,
  with their numbers of messages. `udp` holds the key and size of the datagrams requested by the client, and
  `datagrams` is the process that sends them.
  """
  @type t :: %__MODULE__{}

  @max_window 256 * 1024 * 1024

  @doc "Builds a channel from a client's request. If the request is invalid, returns the reason as text."
  @spec new(Frame.channel(), map()) :: {:ok, t()} | {:error, String.t()}
  def new(id, %{"name" => name} = request) when is_binary(name) do
    with {:ok, from} <- parse_start(request["from"]),
         {:ok, policy} <- parse_policy(request["policy"]),
         {:ok, priority} <- parse_number(request["priority"] || 0, -100, 100, "priority"),
         {:ok, window} <- parse_number(request["window"], 1, @max_window, "window") do
      udp = if Delivery.lossy?(policy), do: parse_datagram_options(request["udp"])
      channel = %__MODULE__{id: id, name: name, from: from, policy: policy, udp: udp}
      {:ok, %{channel | priority: priority, credit: window}}
    end
  end

  def new(_id, _request), do: {:error, "the subscription does not name a stream"}

  defp parse_start("now"), do: {:ok, :now}
  defp parse_start("start"), do: {:ok, :start}
  defp parse_start(%{"after" => time}), do: parse_start_time(time, &{:after, &1})
  defp parse_start(%{"at" => time}), do: parse_start_time(time, &{:at, &1})
  defp parse_start(_other), do: {:error, "the subscription has no valid start"}

  defp parse_start_time(time, from) do
    min = Batch.before_all()

    with {:ok, time} <- parse_number(time, min, -min, "time"), do: {:ok, from.(time)}
  end

  defp parse_policy(nil), do: {:ok, Delivery.unlimited()}
  defp parse_policy("latest"), do: {:ok, Delivery.latest()}

  defp parse_policy(%{"max_queue" => n}),
    do:
      with(
        {:ok, n} <- parse_number(n, 1, 1_000_000, "max_queue"),
        do: {:ok, Delivery.max_queue(n)}
      )

  defp parse_policy(%{"max_latency" => d}),
    do:
      with(
        {:ok, d} <- parse_number(d, 0, 1.0e18, "max_latency"),
        do: {:ok, Delivery.max_latency(d)}
      )

  defp parse_policy(_other), do: {:error, "the delivery policy is unknown"}

  # The client may send malformed options, so they are validated.
  defp parse_datagram_options(%{"key" => text, "size" => size})
       when is_binary(text) and is_integer(size) do
    {min, max} = DatagramCodec.size_range()

    case Base.decode16(text, case: :lower) do
      {:ok, <<key::binary-16>>} when size in min..max//1 -> {key, size}
      _ -> nil
    end
  end

  defp parse_datagram_options(_other), do: nil

  defp parse_number(n, min, max, _name) when is_integer(n) and n >= min and n <= max,
    do: {:ok, n}

  defp parse_number(_n, _min, _max, name), do: {:error, "#{name} is out of range"}

  @doc "Returns whether the channel may send: its stream is open, and the client has granted credit."
  @spec can_send?(t()) :: boolean()
  def can_send?(%__MODULE__{state: :open, credit: credit}), do: credit > 0
  def can_send?(%__MODULE__{}), do: false
end
