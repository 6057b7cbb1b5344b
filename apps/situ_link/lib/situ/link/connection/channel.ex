defmodule Situ.Link.Connection.Channel do
  @moduledoc false
  # Holds the receiver's state of one stream: its position, the data received, and the data that
  # may still arrive. Pure.
  alias Situ.Link.Wire.Frame

  # A server may exceed the window by the frame that fills it.
  @slack 128 * 1024 * 1024
  @max_message 1024 * 1024 * 1024

  @enforce_keys [:id, :pid, :name, :from, :window]
  defstruct [
    :id,
    :pid,
    :name,
    :from,
    :policy,
    :window,
    :last,
    :consumed,
    :consumed_at,
    :datagram,
    :receiver,
    times: :sender,
    priority: 0,
    backlog: 0,
    credit_due: 0,
    parts: [],
    parts_size: 0,
    received: 0,
    lost: 0,
    duplicates: 0,
    ended?: false
  ]

  @typedoc """
  `backlog` counts the bytes that were delivered but not consumed yet, and `credit_due` the consumed bytes that were
  not yet credited to the server. `last` is the originating time of the last delivered message, and `consumed` the
  time of the last consumed one, which was consumed at `consumed_at` by the sender's clock. `datagram` is the
  requested datagram size, and `receiver` is the process that receives datagrams.
  """
  @type t :: %__MODULE__{}

  @spec new(Frame.channel(), pid(), map()) :: t()
  def new(id, pid, request),
    do: struct!(%__MODULE__{id: id, pid: pid, name: "", from: :now, window: 1}, request)

  @doc "Builds the request to a server: from the configured start, or after the last message received."
  @spec build_request(t()) :: {map(), t()}
  def build_request(%__MODULE__{} = channel) do
    from = if channel.last, do: {:after, channel.last}, else: channel.from
    window = max(channel.window - channel.backlog, 1)

    request = %{
      "name" => channel.name,
      "from" => encode_start(from),
      "policy" => channel.policy,
      "priority" => channel.priority,
      "window" => window
    }

    # The new server gets credit only for bytes consumed from now on. Bytes that were not yet credited to the previous
    # server are part of the new window.
    {request, %{channel | credit_due: 0, parts: [], parts_size: 0}}
  end

  defp encode_start({kind, time}), do: %{to_string(kind) => time}
  defp encode_start(start), do: to_string(start)

  @doc "Records that the server has found the stream and will send its messages after `time`."
  @spec mark_subscribed(t(), Situ.Time.t()) :: t()
  def mark_subscribed(%__MODULE__{last: nil} = channel, time), do: %{channel | last: time}
  def mark_subscribed(%__MODULE__{} = channel, _time), do: channel

  @doc """
  Accepts a batch that ends at time `last`. Returns `:duplicate` for a batch that was received
  before.

      iex> alias Situ.Link.Connection.Channel
      iex> request = %{name: "imu", from: :start, policy: nil, priority: 0, window: 1_000, times: :sender}
      iex> channel = Channel.new(1, self(), request)
      iex> {:ok, channel} = Channel.accept_batch(channel, 600, 20, 3)
      iex> {:duplicate, channel} = Channel.accept_batch(channel, 100, 20, 1)
      iex> {map, _} = Channel.build_request(channel)
      iex> map["from"]
      %{"after" => 20}
  """
  @spec accept_batch(t(), non_neg_integer(), Situ.Time.t(), non_neg_integer()) ::
          {:ok | :duplicate, t()} | {:error, String.t()}
  def accept_batch(%__MODULE__{} = channel, size, last, count) do
    cond do
      channel.last != nil and last <= channel.last ->
        {:duplicate,
         %{
           channel
           | credit_due: channel.credit_due + size,
             duplicates: channel.duplicates + count
         }}

      channel.backlog > channel.window + @slack ->
        {:error, "the server sent more of #{inspect(channel.name)} than the window allows"}

      true ->
        backlog = channel.backlog + size
        {:ok, %{channel | backlog: backlog, last: last, received: channel.received + count}}
    end
  end

  @doc """
  Adds one part of a batch. Its bytes are credited immediately, before the other parts arrive, because a message may be
  larger than the window.
  """
  @spec add_part(t(), boolean(), binary()) ::
          {:more, t()} | {:complete, binary(), t()} | {:error, String.t()}
  def add_part(%__MODULE__{} = channel, last?, bytes) do
    size = channel.parts_size + byte_size(bytes)
    parts = [channel.parts, bytes]

    cond do
      size > @max_message ->
        {:error, "a message is larger than 1 GiB"}

      last? ->
        {:complete, IO.iodata_to_binary(parts), %{channel | parts: [], parts_size: 0}}

      true ->
        {:more, add_credit_due(%{channel | parts: parts, parts_size: size}, byte_size(bytes))}
    end
  end

  @doc "Returns whether the window is full. Datagrams are sent without credit, so the receiver must check."
  @spec full?(t()) :: boolean()
  def full?(%__MODULE__{backlog: backlog, window: window}), do: backlog > window

  defp add_credit_due(channel, bytes), do: %{channel | credit_due: channel.credit_due + bytes}

  @doc "Records that the subscriber has consumed `bytes`, up to the time `last`, when the sender's clock was `at`."
  @spec record_consumed(t(), non_neg_integer(), Situ.Time.t() | nil, Situ.Time.t()) :: t()
  def record_consumed(%__MODULE__{} = channel, bytes, last, at) do
    credit_due = channel.credit_due + bytes
    channel = %{channel | backlog: channel.backlog - bytes, credit_due: credit_due}
    if last, do: %{channel | consumed: last, consumed_at: at}, else: channel
  end

  @doc """
  Returns how much older than the sender's clock the last consumed message was when it was consumed, in ns. With
  `waiting?`, later messages exist or may exist, so the lag is measured at the time `now`.
  """
  @spec measure_lag(t(), Situ.Time.t(), boolean()) :: Situ.Time.duration() | nil
  def measure_lag(%__MODULE__{consumed: nil}, _now, _waiting?), do: nil

  def measure_lag(%__MODULE__{} = channel, now, waiting?) do
    at = if waiting? or channel.backlog > 0, do: now, else: channel.consumed_at
    max(at - channel.consumed, 0)
  end

  @doc "Returns the credit to send to the server, or 0 while it is too small to justify a frame."
  @spec take_credit(t()) :: {non_neg_integer(), t()}
  def take_credit(%__MODULE__{credit_due: credit_due, window: window} = channel)
      when credit_due * 4 >= window,
      do: {min(credit_due, 0xFFFFFFFF), %{channel | credit_due: max(credit_due - 0xFFFFFFFF, 0)}}

  def take_credit(%__MODULE__{} = channel), do: {0, channel}

  @spec apply_event(t(), {:closed, Situ.Time.t()} | {:lost, pos_integer()}) :: t()
  def apply_event(%__MODULE__{} = channel, {:closed, _time}), do: %{channel | ended?: true}
  def apply_event(%__MODULE__{} = channel, {:lost, n}), do: %{channel | lost: channel.lost + n}

  @spec channel_stats(t()) :: map()
  def channel_stats(%__MODULE__{} = channel) do
    channel
    |> Map.take([:received, :lost])
    |> Map.merge(%{
      again: channel.duplicates,
      ended: channel.ended?,
      under_way: channel.backlog,
      position: channel.consumed,
      found?: channel.last != nil
    })
  end
end
