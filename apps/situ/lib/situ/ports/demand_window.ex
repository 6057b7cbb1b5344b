defmodule Situ.Ports.DemandWindow do
  @moduledoc false
  # The demand window: how much an input may request from its producer. Pure.
  #
  # The default window is also a budget of bytes: a thousand numbers may be in flight, but not a thousand images. It
  # starts small, weighs the arriving messages, and then requests as many messages as the budget allows. A lossy policy
  # requests no more than its queue holds; the rest waits, or is dropped, at the producer.
  #
  # With 1,000 messages in flight, a decoder in front of a consumer that took 15 ms per image held
  # 868 MB. With the budget in bytes it held 100 MB.
  # See docs/adr/0011-demand-uses-genstage-messages.md.
  alias Situ.{Columns, Delivery}
  alias Situ.Delivery.Batch

  @default Delivery.unlimited().window
  @first 8
  @budget 32_000_000
  @least 4
  # Messages in columns take sixteen bytes, and have a cost for each batch rather than for each message.
  @columns 8_192

  @enforce_keys [:size]
  defstruct [:size, :limit, weigh: false, unweighed: 0, owed: 0]

  @typedoc """
  `owed`: messages taken and not yet requested again; `unweighed`: messages until the next one is weighed; `limit`: the
  size that a throttle prescribes as soon as the producer is in another process.
  """
  @type t :: %__MODULE__{
          size: pos_integer() | :infinity,
          limit: pos_integer() | nil,
          weigh: boolean(),
          unweighed: integer(),
          owed: integer()
        }

  @spec new(Delivery.t()) :: t()
  def new(%Delivery{kind: :unlimited, window: @default, max_queue: :infinity} = policy) do
    if Delivery.lossy?(policy),
      do: %__MODULE__{size: @default},
      else: %__MODULE__{size: @first, weigh: true}
  end

  def new(%Delivery{max_queue: n}) when is_integer(n), do: %__MODULE__{size: min(n, @default)}
  # So many wait while one is handled.
  def new(%Delivery{kind: :throttle, window: n}) when is_integer(n), do: %__MODULE__{size: n + 1}
  def new(%Delivery{window: window}), do: %__MODULE__{size: window}

  @doc """
  Returns the window of an input whose producer is in the same process. The two take turns, so a throttle has nothing to
  limit.
  """
  @spec new_local(Delivery.t()) :: t()
  def new_local(%Delivery{kind: kind} = policy) when kind in [:throttle, :synchronous] do
    case new(policy) do
      %{size: :infinity} = window -> window
      %{size: size} -> %{new(Delivery.unlimited()) | limit: size}
    end
  end

  def new_local(policy), do: new(policy)

  @doc "Applies the limit of a throttle, because the producer and the consumer have separate processes from now on."
  @spec apply_limit(t()) :: t()
  def apply_limit(%__MODULE__{limit: nil} = window), do: window

  def apply_limit(%__MODULE__{limit: limit, size: size, owed: owed}),
    do: %__MODULE__{size: limit, owed: owed + limit - size}

  @doc "Weighs the data of a batch's first message, which adjusts the window."
  @spec weigh_batch(t(), Batch.t()) :: t()
  def weigh_batch(%__MODULE__{weigh: false} = window, _batch), do: window
  def weigh_batch(%__MODULE__{size: @columns} = window, %Columns{}), do: window
  def weigh_batch(%__MODULE__{} = window, %Columns{}), do: resize_window(window, @columns)

  def weigh_batch(%__MODULE__{} = window, batch) do
    case weight(Batch.first_data(batch), window.unweighed) do
      :unknown -> %{window | unweighed: window.unweighed - 1}
      bytes -> resize_window(window, div(@budget, max(bytes, 1)) |> max(@least) |> min(@default))
    end
  end

  # When the window grows, demand is sent immediately; when it shrinks, later demand is reduced.
  defp resize_window(window, size) do
    owed = window.owed + size - window.size
    %{window | size: size, owed: owed, unweighed: div(size, 2)}
  end

  # Images and audio are weighed every time, since it costs nothing; other terms once in half a window.
  defp weight(%{data: bytes}, _left) when is_binary(bytes), do: byte_size(bytes)
  defp weight(bytes, _left) when is_binary(bytes), do: byte_size(bytes)
  defp weight(data, left) when left <= 0, do: Batch.data_size(data)
  defp weight(_data, _left), do: :unknown

  @doc "Adds `n` messages that have left the queue."
  @spec add_owed(t(), non_neg_integer()) :: t()
  def add_owed(%__MODULE__{} = window, n), do: %{window | owed: window.owed + n}

  @doc "Returns how much to request now: nothing until it is half of the window."
  @spec take_owed(t()) :: {non_neg_integer(), t()}
  def take_owed(%__MODULE__{size: size, owed: owed} = window) do
    if size != :infinity and owed > 0 and owed >= div(size, 2),
      do: {owed, %{window | owed: 0}},
      else: {0, window}
  end

  @doc "Clears the owed demand, because a new producer knows of none."
  @spec reset_owed(t()) :: t()
  def reset_owed(%__MODULE__{} = window), do: %{window | owed: 0}
end
