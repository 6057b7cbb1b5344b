defmodule Situ.Stage.Inlet do
  @moduledoc false
  # One connected input of a running component: what waits, under its policy, and the demand it owes its producer. Pure
  # but for the counters; the stage sends the asks.
  #
  # The default window is also a budget of bytes: a thousand numbers may be on their way, but not a thousand pictures. An
  # inlet begins with a small window, weighs what arrives, and then asks for as many messages as the budget holds.
  alias Situ.{Delivery, Error, Message, Type}
  alias Situ.Delivery.Queue
  alias Situ.Stage.Counters

  @open_demand 1_000_000
  @default_window Delivery.unlimited().window
  @first_window 8
  @budget 32_000_000
  @least_window 4

  defstruct [
    :name,
    :tag,
    :producer,
    :policy,
    :type,
    :check,
    :counters,
    :queue,
    lossy: false,
    sizes: false,
    front: [],
    rear: [],
    window: 1_000,
    weigh: false,
    unweighed: 0,
    owed: 0,
    taken: 0,
    taken_latency: 0,
    reached: 0,
    busy: 0,
    closed: nil,
    held: nil
  ]

  @type t :: %__MODULE__{}

  @spec new(atom(), term(), pid(), Delivery.t(), map()) :: t()
  def new(name, tag, producer, policy, extra) do
    lossy = Delivery.lossy?(policy)
    weigh = not lossy and policy.kind == :unlimited and policy.window == @default_window

    %__MODULE__{
      name: name,
      tag: tag,
      producer: producer,
      policy: policy,
      type: extra.type,
      check: if(extra.type == :any, do: :off, else: extra.check),
      counters: extra.counters,
      lossy: lossy,
      sizes: extra.sizes,
      queue: if(lossy, do: Queue.new(policy)),
      weigh: weigh,
      window: first_window(lossy, weigh, policy)
    }
  end

  defp first_window(true, _weigh, _policy), do: @open_demand
  defp first_window(false, true, _policy), do: @first_window
  defp first_window(false, false, policy), do: policy.window

  @doc "A batch arrived."
  @spec push(t(), [Message.t()]) :: t()
  def push(%__MODULE__{} = inlet, [first | _] = messages) do
    if inlet.sizes, do: Counters.sized(inlet.counters, messages)
    inlet = if inlet.weigh, do: weigh(inlet, first), else: inlet
    enter(inlet, messages)
  end

  def push(%__MODULE__{} = inlet, []), do: inlet

  defp weigh(inlet, message) do
    case weight(message, inlet.unweighed) do
      :unknown ->
        %{inlet | unweighed: inlet.unweighed - 1}

      bytes ->
        window = div(@budget, max(bytes, 1)) |> max(@least_window) |> min(@default_window)
        # What the window grows by is owed at once; what it shrinks by is taken off what will be.
        owed = inlet.owed + window - inlet.window
        %{inlet | window: window, owed: owed, unweighed: div(window, 2)}
    end
  end

  # Pictures and sound are weighed every time, since it costs nothing; other terms once in half a window.
  defp weight(%Message{data: %{data: bytes}}, _left) when is_binary(bytes), do: byte_size(bytes)
  defp weight(%Message{data: bytes}, _left) when is_binary(bytes), do: byte_size(bytes)
  defp weight(message, left) when left <= 0, do: Message.size(message)
  defp weight(_message, _left), do: :unknown

  defp enter(%__MODULE__{lossy: false, front: [], rear: []} = inlet, messages),
    do: %{inlet | front: messages}

  defp enter(%__MODULE__{lossy: false} = inlet, messages),
    do: %{inlet | rear: [messages | inlet.rear]}

  defp enter(%__MODULE__{} = inlet, messages) do
    {queue, dropped} = Enum.reduce(messages, {inlet.queue, 0}, &enqueue/2)
    drop(inlet, dropped)
    %{inlet | queue: queue, owed: inlet.owed + length(messages)}
  end

  @doc "The closing mark arrived."
  @spec push_closed(t(), Situ.Time.t()) :: t()
  def push_closed(%__MODULE__{lossy: false} = inlet, time) do
    {late, rest} = inlet |> waiting() |> Enum.split_while(&(&1.originating_time > time))
    drop(inlet, length(late))
    %{inlet | front: rest ++ [{:closed, time}], rear: []}
  end

  def push_closed(%__MODULE__{} = inlet, time) do
    {queue, dropped} = Queue.push(inlet.queue, {:closed, time})
    drop(inlet, length(dropped))
    %{inlet | queue: queue}
  end

  @doc "The originating time of the head, or `:none`."
  @spec head_time(t()) :: Situ.Time.t() | :none
  def head_time(%__MODULE__{held: {_timer, _token}}), do: :none
  def head_time(%__MODULE__{lossy: false, front: [head | _]}), do: time_of(head)
  def head_time(%__MODULE__{lossy: false, rear: []}), do: :none

  def head_time(%__MODULE__{lossy: false} = inlet),
    do: inlet.rear |> List.last() |> hd() |> time_of()

  def head_time(%__MODULE__{queue: queue}) do
    case Queue.peek(queue) do
      nil -> :none
      entry -> time_of(entry)
    end
  end

  @doc "Takes the next entry at clock time `now`."
  @spec pop(t(), Situ.Time.t()) :: {Queue.entry() | nil, t()}
  def pop(%__MODULE__{lossy: false, front: [head | front]} = inlet, _now),
    do: {head, %{inlet | front: front}}

  def pop(%__MODULE__{lossy: false, rear: []} = inlet, _now), do: {nil, inlet}

  def pop(%__MODULE__{lossy: false, rear: rear} = inlet, now),
    do: pop(%{inlet | front: rear |> :lists.reverse() |> :lists.append(), rear: []}, now)

  def pop(%__MODULE__{} = inlet, now) do
    {entry, queue, dropped} = Queue.pop(inlet.queue, now)
    drop(inlet, length(dropped))
    {entry, %{inlet | queue: queue}}
  end

  @doc "Takes up to `n` messages of a lossless inlet (never the closing mark)."
  @spec take(t(), pos_integer()) :: {[Message.t()], t()}
  def take(%__MODULE__{front: [], rear: []} = inlet, _n), do: {[], inlet}

  def take(%__MODULE__{front: [], rear: rear} = inlet, n),
    do: take(%{inlet | front: rear |> :lists.reverse() |> :lists.append(), rear: []}, n)

  def take(%__MODULE__{front: front} = inlet, n) do
    {taken, rest} = split(front, n, [])
    {taken, %{inlet | front: rest}}
  end

  @doc "Counts `n` messages as handled, the last of them from `time`; `settle/1` publishes."
  @spec handled(t(), pos_integer(), Situ.Time.t(), {now :: Situ.Time.t(), busy :: integer()}) ::
          t()
  def handled(%__MODULE__{} = inlet, n, time, {now, busy}) do
    %{
      inlet
      | taken: inlet.taken + n,
        reached: time,
        taken_latency: now - time,
        busy: inlet.busy + busy
    }
  end

  @doc "Publishes counts; answers how much to ask of the producer now."
  @spec settle(t()) :: {non_neg_integer(), t()}
  def settle(%__MODULE__{taken: 0, owed: 0} = inlet), do: {0, inlet}

  def settle(%__MODULE__{} = inlet) do
    if inlet.taken > 0 do
      Counters.processed(inlet.counters, inlet.taken, inlet.taken_latency, inlet.busy)
      Counters.reached(inlet.counters, inlet.reached)
    end

    owed = if inlet.lossy, do: inlet.owed, else: inlet.owed + inlet.taken
    inlet = %{inlet | taken: 0, busy: 0}

    if inlet.window != :infinity and owed >= max(div(inlet.window, 2), 1),
      do: {owed, %{inlet | owed: 0}},
      else: {0, %{inlet | owed: owed}}
  end

  @doc "Counts `n` messages as dropped without looking at them."
  @spec drop(t(), non_neg_integer()) :: :ok
  def drop(_inlet, 0), do: :ok
  def drop(inlet, n), do: Counters.dropped(inlet.counters, n)

  @doc "Whether the data is of the input's type, as far as `check` asks; the first good one ends `:first`."
  @spec check(t(), Message.t(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def check(%__MODULE__{check: :off} = inlet, _message, _path), do: {:ok, inlet}

  def check(%__MODULE__{type: type} = inlet, message, path) do
    cond do
      not Type.valid?(type, message.data) -> {:error, wrong_type(inlet, message, path)}
      inlet.check == :first -> {:ok, %{inlet | check: :off}}
      true -> {:ok, inlet}
    end
  end

  defp enqueue(message, {queue, dropped}) do
    {queue, lost} = Queue.push(queue, message)
    {queue, dropped + length(lost)}
  end

  defp waiting(%{front: front, rear: []}), do: front

  defp waiting(%{front: front, rear: rear}),
    do: front ++ (rear |> :lists.reverse() |> :lists.append())

  defp split([%Message{} = message | rest], n, taken) when n > 0,
    do: split(rest, n - 1, [message | taken])

  defp split(rest, _n, taken), do: {:lists.reverse(taken), rest}

  defp time_of({:closed, time}), do: time
  defp time_of(%Message{originating_time: time}), do: time

  defp wrong_type(inlet, message, path) do
    Error.new(
      :wrong_data,
      "#{path}.#{inlet.name} takes #{Type.to_string(inlet.type)}, got: #{inspect(message.data, limit: 8, printable_limit: 80)}",
      why:
        "the stream was declared to carry it (the first message is checked; check: :all checks each)",
      fix: "correct the declared type of the stream, or convert the data before",
      meta: %{component: path, input: inlet.name, originating_time: message.originating_time}
    )
  end
end
