defmodule Situ.Live.DataSocket.Channel do
  @moduledoc false
  # Credits and waiting frames of one channel. Pure.

  defstruct [:id, :limit, credits: 0, dropped: 0, waiting: :queue.new(), size: 0]

  @type t :: %__MODULE__{}

  @spec new(non_neg_integer(), non_neg_integer(), keyword()) :: t()
  def new(id, credits, opts) do
    limit =
      case Keyword.get(opts, :queue, :latest) do
        :latest -> 1
        n when is_integer(n) and n > 0 -> n
      end

    %__MODULE__{id: id, credits: credits, limit: limit}
  end

  @doc "A frame to send, or to keep until there is a credit."
  @spec push(t(), map()) :: {[{:binary, iodata()}], t()}
  def push(%__MODULE__{credits: credits, size: 0} = channel, frame) when credits > 0 do
    {[encode(channel, frame)], %{channel | credits: credits - 1, dropped: 0}}
  end

  def push(%__MODULE__{size: size, limit: limit} = channel, frame) when size < limit do
    {[], %{channel | waiting: :queue.in(frame, channel.waiting), size: size + 1}}
  end

  def push(%__MODULE__{} = channel, frame) do
    waiting = :queue.in(frame, :queue.drop(channel.waiting))
    {[], %{channel | waiting: waiting, dropped: min(channel.dropped + 1, 65_535)}}
  end

  @doc "More credits; what waited goes out as far as they reach."
  @spec grant(t(), pos_integer()) :: {[{:binary, iodata()}], t()}
  def grant(%__MODULE__{} = channel, n) do
    release(%{channel | credits: min(channel.credits + n, 10_000)}, [])
  end

  defp release(%__MODULE__{credits: credits, size: size} = channel, out)
       when credits > 0 and size > 0 do
    {{:value, frame}, waiting} = :queue.out(channel.waiting)
    sent = encode(channel, frame)

    channel
    |> Map.merge(%{waiting: waiting, size: size - 1, credits: credits - 1, dropped: 0})
    |> release([sent | out])
  end

  defp release(channel, out), do: {Enum.reverse(out), channel}

  defp encode(%__MODULE__{id: id, dropped: dropped}, %{kind: kind, data: data} = frame) do
    time = Map.get(frame, :time, 0)
    {:binary, [<<1, kind, dropped::little-16, id::little-32, time::little-signed-64>>, data]}
  end
end
