defmodule Situ.Ports.Window do
  @moduledoc false
  # How much an input may ask of its producer: the demand window. Pure.
  #
  # The default window is also a budget of bytes: a thousand numbers may be on their way, but not a thousand
  # pictures. It begins small, weighs what arrives, and then asks for as many messages as the budget holds. A lossy
  # policy asks for no more than its queue holds: the rest waits, and is dropped, at the producer.
  alias Situ.{Delivery, Message}

  @default Delivery.unlimited().window
  @first 8
  @budget 32_000_000
  @least 4

  @enforce_keys [:size]
  defstruct [:size, weigh: false, unweighed: 0, owed: 0]

  @typedoc "`owed`: messages taken and not yet asked for again; `unweighed`: how many more before one is weighed."
  @type t :: %__MODULE__{
          size: pos_integer() | :infinity,
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

  @doc "The first of a batch that has arrived: what it weighs changes the window."
  @spec weigh(t(), Message.t()) :: t()
  def weigh(%__MODULE__{weigh: false} = window, _message), do: window

  def weigh(%__MODULE__{} = window, message) do
    case weight(message, window.unweighed) do
      :unknown ->
        %{window | unweighed: window.unweighed - 1}

      bytes ->
        size = div(@budget, max(bytes, 1)) |> max(@least) |> min(@default)
        # Growth of the window is owed at once; shrinkage is taken off later demand.
        owed = window.owed + size - window.size
        %{window | size: size, owed: owed, unweighed: div(size, 2)}
    end
  end

  # Pictures and sound are weighed every time, since it costs nothing; other terms once in half a window.
  defp weight(%Message{data: %{data: bytes}}, _left) when is_binary(bytes), do: byte_size(bytes)
  defp weight(%Message{data: bytes}, _left) when is_binary(bytes), do: byte_size(bytes)
  defp weight(message, left) when left <= 0, do: Message.size(message)
  defp weight(_message, _left), do: :unknown

  @doc "`n` messages have left the queue."
  @spec owe(t(), non_neg_integer()) :: t()
  def owe(%__MODULE__{} = window, n), do: %{window | owed: window.owed + n}

  @doc "How much to ask for now: nothing until it is half of the window."
  @spec ask(t()) :: {non_neg_integer(), t()}
  def ask(%__MODULE__{size: size, owed: owed} = window) do
    if size != :infinity and owed > 0 and owed >= div(size, 2),
      do: {owed, %{window | owed: 0}},
      else: {0, window}
  end

  @doc "The producer is another one, which knows of no demand."
  @spec renew(t()) :: t()
  def renew(%__MODULE__{} = window), do: %{window | owed: 0}
end
