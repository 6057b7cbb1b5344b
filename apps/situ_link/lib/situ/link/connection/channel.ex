defmodule Situ.Link.Connection.Channel do
  @moduledoc """
  Holds the receiver's state of one stream: its position, the data received, and the data that may still arrive.
  Pure.

      iex> alias Situ.Link.Connection.Channel
      iex> wanted = %{name: "imu", from: :start, policy: nil, priority: 0, window: 1_000, times: :sender}
      iex> channel = Channel.new(1, self(), wanted)
      iex> {:ok, channel} = Channel.accept_batch(channel, 600, 20, 3)
      iex> {:again, channel} = Channel.accept_batch(channel, 100, 20, 1)
      iex> {map, _} = Channel.build_request(channel)
      iex> map["from"]
      %{"after" => 20}
  """
  alias Situ.Link.Wire.Frame

  # A server may exceed the window by the frame that fills it.
  @slack 128 * 1024 * 1024
  @most_message 1024 * 1024 * 1024

  @enforce_keys [:id, :pid, :name, :from, :window]
  defstruct [
    :id,
    :pid,
    :name,
    :from,
    :policy,
    :window,
    :last,
    :taken,
    :datagram,
    :aside,
    times: :sender,
    priority: 0,
    under_way: 0,
    unpaid: 0,
    parts: [],
    parts_size: 0,
    received: 0,
    lost: 0,
    again: 0,
    ended: false
  ]

  @typedoc """
  `under_way` counts the bytes that were delivered but not consumed yet, and `unpaid` the consumed bytes that were not
  yet credited to the server. `last` is the originating time of the last delivered message, and `taken` the time of the
  last consumed one. `datagram` is the requested datagram size, and `aside` is the process that receives datagrams.
  """
  @type t :: %__MODULE__{}

  @spec new(Frame.channel(), pid(), map()) :: t()
  def new(id, pid, wanted),
    do: struct!(%__MODULE__{id: id, pid: pid, name: "", from: :now, window: 1}, wanted)

  @doc "Builds the request to a server: from the configured start, or after the last message received."
  @spec build_request(t()) :: {map(), t()}
  def build_request(%__MODULE__{} = channel) do
    from = if channel.last, do: {:after, channel.last}, else: channel.from
    window = max(channel.window - channel.under_way, 1)

    map = %{
      "name" => channel.name,
      "from" => encode_start(from),
      "policy" => channel.policy,
      "priority" => channel.priority,
      "window" => window
    }

    # The new server gets credit only for bytes consumed from now on. Bytes that were not yet credited to the previous
    # server are part of the new window.
    {map, %{channel | unpaid: 0, parts: [], parts_size: 0}}
  end

  defp encode_start({kind, time}), do: %{to_string(kind) => time}
  defp encode_start(word), do: to_string(word)

  @doc "Records that the server has found the stream and will send its messages after `time`."
  @spec mark_subscribed(t(), Situ.Time.t()) :: t()
  def mark_subscribed(%__MODULE__{last: nil} = channel, time), do: %{channel | last: time}
  def mark_subscribed(%__MODULE__{} = channel, _time), do: channel

  @doc "Accepts a batch that ends at time `last`. Returns `:again` for a batch that was received before."
  @spec accept_batch(t(), non_neg_integer(), Situ.Time.t(), non_neg_integer()) ::
          {:ok | :again, t()} | {:error, String.t()}
  def accept_batch(%__MODULE__{} = channel, size, last, count) do
    cond do
      channel.last != nil and last <= channel.last ->
        {:again, %{channel | unpaid: channel.unpaid + size, again: channel.again + count}}

      channel.under_way > channel.window + @slack ->
        {:error, "the server sent more of #{inspect(channel.name)} than the window allows"}

      true ->
        under_way = channel.under_way + size
        {:ok, %{channel | under_way: under_way, last: last, received: channel.received + count}}
    end
  end

  @doc """
  Adds one part of a batch. Its bytes are credited immediately, before the other parts arrive, because a message may be
  larger than the window.
  """
  @spec add_part(t(), boolean(), binary()) ::
          {:more, t()} | {:whole, binary(), t()} | {:error, String.t()}
  def add_part(%__MODULE__{} = channel, last?, bytes) do
    size = channel.parts_size + byte_size(bytes)
    parts = [channel.parts, bytes]

    cond do
      size > @most_message -> {:error, "a message is larger than 1 GiB"}
      last? -> {:whole, IO.iodata_to_binary(parts), %{channel | parts: [], parts_size: 0}}
      true -> {:more, add_unpaid(%{channel | parts: parts, parts_size: size}, byte_size(bytes))}
    end
  end

  @doc "Returns whether the window is full. Datagrams are sent without credit, so the receiver must check."
  @spec full?(t()) :: boolean()
  def full?(%__MODULE__{under_way: under_way, window: window}), do: under_way > window

  defp add_unpaid(channel, bytes), do: %{channel | unpaid: channel.unpaid + bytes}

  @doc "Records that the subscriber has consumed `bytes`, up to the time `last`."
  @spec record_consumed(t(), non_neg_integer(), Situ.Time.t() | nil) :: t()
  def record_consumed(%__MODULE__{} = channel, bytes, last) do
    unpaid = channel.unpaid + bytes

    %{
      channel
      | under_way: channel.under_way - bytes,
        unpaid: unpaid,
        taken: last || channel.taken
    }
  end

  @doc "Returns the credit to send to the server, or 0 while it is too small to justify a frame."
  @spec take_credit(t()) :: {non_neg_integer(), t()}
  def take_credit(%__MODULE__{unpaid: unpaid, window: window} = channel)
      when unpaid * 4 >= window,
      do: {min(unpaid, 0xFFFFFFFF), %{channel | unpaid: max(unpaid - 0xFFFFFFFF, 0)}}

  def take_credit(%__MODULE__{} = channel), do: {0, channel}

  @spec apply_event(t(), {:closed, Situ.Time.t()} | {:lost, pos_integer()}) :: t()
  def apply_event(%__MODULE__{} = channel, {:closed, _time}), do: %{channel | ended: true}
  def apply_event(%__MODULE__{} = channel, {:lost, n}), do: %{channel | lost: channel.lost + n}

  @spec channel_stats(t()) :: map()
  def channel_stats(%__MODULE__{} = channel) do
    channel
    |> Map.take([:received, :lost, :again, :ended, :under_way])
    |> Map.merge(%{position: channel.taken, found?: channel.last != nil})
  end
end
