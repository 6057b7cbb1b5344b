defmodule Situ.Ports.Input do
  @moduledoc false
  # One connected input of a running component: its waiting messages under its policy, and the demand it owes its
  # producer.
  #
  # Under a lossy policy there are two queues: requested messages wait here, the others at the producer (see
  # Subscriber). After a slow callback, the producer is asked for all its messages before the next one is taken, so that
  # the policy applies to everything that was emitted.
  alias Situ.{Delivery, Error, Message, Type}
  alias Situ.Delivery.Queue
  alias Situ.Ports.{Counters, DemandWindow}

  @hold_ms 20
  # Asking takes longer than this, so that it costs a part of the throughput only.
  @stale_ns 50_000
  @nothing {0, 0, 0, 0}

  @enforce_keys [:name, :tag, :producer, :window]
  defstruct [
    :name,
    :tag,
    :producer,
    :window,
    :type,
    :counters,
    :queue,
    :held,
    check: :off,
    sizes: false,
    front: [],
    rear: [],
    fresh: 0,
    handled: @nothing
  ]

  @typedoc """
  `front` and `rear` (reversed batches) hold waiting messages under a lossless policy, `queue` under a lossy one. `held`
  is a timer and token while the component pauses the input. `fresh` (lossy only) is the time at which the waiting
  messages were known to be the newest, or `:asked`, or `:sure` for the next take. `handled` holds the number of
  messages handled since the last publication, the latency and originating time of the last one, and the ns spent.
  """
  @type t :: %__MODULE__{
          name: atom(),
          tag: term(),
          producer: pid(),
          window: DemandWindow.t(),
          type: Type.t(),
          counters: Counters.t() | nil,
          queue: Queue.t() | nil,
          held: {reference(), reference()} | nil,
          check: :off | :first | :all,
          sizes: boolean(),
          front: [Queue.entry()],
          rear: [[Message.t()]],
          fresh: integer() | :asked | :sure,
          handled: {non_neg_integer(), integer(), Situ.Time.t(), integer()}
        }

  @spec new(atom(), term(), pid(), Delivery.t(), map()) :: t()
  def new(name, tag, producer, policy, extra) do
    %__MODULE__{
      name: name,
      tag: tag,
      producer: producer,
      type: extra.type,
      check: if(extra.type == :any, do: :off, else: extra.check),
      counters: extra.counters,
      sizes: extra.sizes,
      queue: if(Delivery.lossy?(policy), do: Queue.new(policy)),
      window: DemandWindow.new(policy)
    }
  end

  @doc "Requests the first messages from the producer."
  @spec request_first(t()) :: term()
  def request_first(%__MODULE__{} = input), do: ask(input, input.window.size)

  defp ask(input, n), do: send(input.producer, {:"$gen_producer", {self(), input.tag}, {:ask, n}})

  @doc "Replaces the producer's process."
  @spec replace_producer(t(), pid()) :: t()
  def replace_producer(%__MODULE__{} = input, pid),
    do: %{input | producer: pid, window: DemandWindow.reset_owed(input.window), fresh: 0}

  @doc "Adds a batch that arrived."
  @spec push(t(), [Message.t()]) :: t()
  def push(%__MODULE__{} = input, []), do: input

  def push(%__MODULE__{} = input, [first | _] = messages) do
    if input.sizes, do: Counters.count_sizes(input.counters, messages)
    enter(%{input | window: DemandWindow.weigh_message(input.window, first)}, messages)
  end

  defp enter(%__MODULE__{queue: nil, front: [], rear: []} = input, messages),
    do: %{input | front: messages}

  defp enter(%__MODULE__{queue: nil} = input, messages),
    do: %{input | rear: [messages | input.rear]}

  defp enter(%__MODULE__{queue: queue} = input, messages) do
    {queue, dropped} = Queue.push_all(queue, messages)
    drop(input, dropped)
    owed = if queue.policy.throttle, do: dropped, else: length(messages)
    %{input | queue: queue, window: DemandWindow.add_owed(input.window, owed)}
  end

  @doc "Adds all messages that the producer held back; the waiting messages are then the newest."
  @spec push_refreshed(t(), [Message.t()]) :: t()
  def push_refreshed(%__MODULE__{queue: nil} = input, messages), do: push(input, messages)

  def push_refreshed(%__MODULE__{} = input, messages) do
    window = input.window
    %{push(input, messages) | window: window, fresh: :sure}
  end

  @doc "Adds the closing mark."
  @spec push_closed(t(), Situ.Time.t()) :: t()
  def push_closed(%__MODULE__{queue: nil} = input, time) do
    {late, rest} = input |> waiting() |> Enum.split_while(&(&1.originating_time > time))
    drop(input, length(late))
    %{input | front: rest ++ [{:closed, time}], rear: []}
  end

  def push_closed(%__MODULE__{} = input, time) do
    {queue, dropped} = Queue.push(input.queue, {:closed, time})
    drop(input, length(dropped))
    %{input | queue: queue, fresh: :sure}
  end

  @doc "Returns the originating time of the head, or `:none`."
  @spec head_time(t()) :: Situ.Time.t() | :none
  def head_time(%__MODULE__{held: {_timer, _token}}), do: :none
  def head_time(%__MODULE__{queue: nil, front: [head | _]}), do: time_of(head)
  def head_time(%__MODULE__{queue: nil, rear: []}), do: :none

  def head_time(%__MODULE__{queue: nil} = input),
    do: input.rear |> List.last() |> hd() |> time_of()

  def head_time(%__MODULE__{fresh: :asked}), do: :none

  def head_time(%__MODULE__{queue: queue}) do
    case Queue.peek(queue) do
      nil -> :none
      entry -> time_of(entry)
    end
  end

  @doc "Prepares to take a message; returns `:wait` if the producer of a lossy input is first asked for newer ones."
  @spec ensure_fresh(t()) :: {:ok | :wait, t()}
  def ensure_fresh(%__MODULE__{queue: nil} = input), do: {:ok, input}
  def ensure_fresh(%__MODULE__{queue: %{policy: %{throttle: true}}} = input), do: {:ok, input}

  def ensure_fresh(%__MODULE__{fresh: known} = input) do
    now = :erlang.monotonic_time()

    if known == :sure or now - known < @stale_ns or Counters.held_count(input.counters) == 0 do
      {:ok, %{input | fresh: now}}
    else
      Counters.request_held(input.counters)
      send(input.producer, {:situ, {:refresh, {self(), input.tag}}})
      {:wait, %{input | fresh: :asked}}
    end
  end

  @doc "Takes the next entry at clock time `now`."
  @spec pop(t(), Situ.Time.t()) :: {Queue.entry() | nil, t()}
  def pop(%__MODULE__{queue: nil, front: [head | front]} = input, _now),
    do: {head, %{input | front: front}}

  def pop(%__MODULE__{queue: nil, rear: []} = input, _now), do: {nil, input}
  def pop(%__MODULE__{queue: nil} = input, now), do: pop(turn(input), now)

  def pop(%__MODULE__{} = input, now) do
    {entry, queue, dropped} = Queue.pop(input.queue, now)
    n = length(dropped)
    drop(input, n)
    owed = if queue.policy.throttle, do: n + if(entry, do: 1, else: 0), else: 0
    {entry, %{input | queue: queue, window: DemandWindow.add_owed(input.window, owed)}}
  end

  @doc "Takes up to `n` messages of a lossless input (never the closing mark)."
  @spec take_batch(t(), pos_integer()) :: {[Message.t()], t()}
  def take_batch(%__MODULE__{front: [], rear: []} = input, _n), do: {[], input}
  def take_batch(%__MODULE__{front: []} = input, n), do: take_batch(turn(input), n)

  def take_batch(%__MODULE__{front: front} = input, n) do
    {taken, rest} = split(front, n, [])
    {taken, %{input | front: rest}}
  end

  @doc "Puts messages that were taken but not handled back at the front of the queue."
  @spec put_back(t(), [Message.t()]) :: t()
  def put_back(%__MODULE__{} = input, []), do: input

  def put_back(%__MODULE__{queue: nil} = input, messages),
    do: %{input | front: messages ++ input.front}

  @doc "Discards all waiting messages; returns the time of the closing mark if there was one."
  @spec discard_all(t()) :: {Situ.Time.t() | nil, t()}
  def discard_all(%__MODULE__{} = input) do
    {messages, rest} = input |> waiting() |> Enum.split_while(&is_struct/1)
    n = length(messages)
    input = %{input | front: [], rear: [], queue: input.queue && Queue.new(input.queue.policy)}
    closed = with([{:closed, time} | _] <- rest, do: time, else: (_ -> nil))
    {closed, drop_taken(input, n)}
  end

  @doc "Counts `n` messages as handled, the last at `time`; `publish_counts/1` publishes the counts."
  @spec count_handled(
          t(),
          pos_integer(),
          Situ.Time.t(),
          {now :: Situ.Time.t(), busy :: integer()}
        ) ::
          t()
  def count_handled(%__MODULE__{handled: {taken, _, _, spent}} = input, n, time, {now, busy}),
    do: %{input | handled: {taken + n, now - time, time, spent + busy}}

  @doc "Returns whether there are no counts to publish and no demand to send."
  @spec nothing_to_settle?(t()) :: boolean()
  def nothing_to_settle?(%__MODULE__{handled: @nothing, window: %{owed: 0}}), do: true
  def nothing_to_settle?(%__MODULE__{}), do: false

  @doc "Returns whether no messages wait in the input."
  @spec empty?(t()) :: boolean()
  def empty?(%__MODULE__{queue: nil, front: front, rear: rear}), do: front == [] and rear == []
  def empty?(%__MODULE__{queue: %{size: size}}), do: size == 0

  @doc "Publishes the counts, and sends demand to the producer when enough is owed."
  @spec publish_counts(t()) :: t()
  def publish_counts(
        %__MODULE__{handled: {taken, latency, reached, busy}, window: window} = input
      ) do
    if taken > 0 do
      Counters.count_processed(input.counters, taken, latency, busy)
      Counters.record_reached(input.counters, reached, reached + latency)
    end

    {n, window} =
      DemandWindow.take_owed(
        if(input.queue == nil, do: DemandWindow.add_owed(window, taken), else: window)
      )

    if n > 0, do: ask(input, n)
    %{input | handled: @nothing, window: window}
  end

  @doc "Returns how many messages were taken according to the counters."
  @spec taken_count(t()) :: non_neg_integer()
  def taken_count(%__MODULE__{counters: counters}) do
    {_emitted, processed, dropped} = Counters.flow_counts(counters)
    processed + dropped
  end

  @doc "Counts `n` taken messages as dropped and returns their demand to the producer."
  @spec drop_taken(t(), non_neg_integer()) :: t()
  def drop_taken(%__MODULE__{} = input, n) do
    drop(input, n)
    if input.queue, do: input, else: %{input | window: DemandWindow.add_owed(input.window, n)}
  end

  defp drop(_input, 0), do: :ok
  defp drop(input, n), do: Counters.count_dropped(input.counters, n)

  @doc "Pauses the input for 20 ms or until it is resumed; pausing it again restarts the time."
  @spec set_hold(t(), boolean()) :: t()
  def set_hold(%__MODULE__{} = input, held?) do
    with {timer, _token} <- input.held, do: Process.cancel_timer(timer)
    %{input | held: if(held?, do: hold_timer(input.tag))}
  end

  defp hold_timer(tag) do
    token = make_ref()
    {Process.send_after(self(), {:situ_hold, tag, token}, @hold_ms), token}
  end

  @doc "Checks that the data has the input's type, as `check` requires; a first valid message ends `:first`."
  @spec check_type(t(), Message.t(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def check_type(%__MODULE__{check: :off} = input, _message, _path), do: {:ok, input}

  def check_type(%__MODULE__{type: type} = input, message, path) do
    cond do
      not Type.valid_value?(type, message.data) -> {:error, wrong_type(input, message, path)}
      input.check == :first -> {:ok, %{input | check: :off}}
      true -> {:ok, input}
    end
  end

  defp waiting(%{queue: nil, front: front, rear: []}), do: front

  defp waiting(%{queue: nil, front: front, rear: rear}),
    do: front ++ (rear |> :lists.reverse() |> :lists.append())

  defp waiting(%{queue: queue}), do: Queue.to_list(queue)

  defp turn(%{rear: rear} = input),
    do: %{input | front: rear |> :lists.reverse() |> :lists.append(), rear: []}

  defp split([%Message{} = message | rest], n, taken) when n > 0,
    do: split(rest, n - 1, [message | taken])

  defp split(rest, _n, taken), do: {:lists.reverse(taken), rest}

  defp time_of({:closed, time}), do: time
  defp time_of(%Message{originating_time: time}), do: time

  defp wrong_type(input, message, path) do
    data = inspect(message.data, limit: 8, printable_limit: 80)

    Error.new(
      :wrong_data,
      "#{path}.#{input.name} takes #{Type.to_string(input.type)}, got: #{data}",
      why:
        "the stream was declared to carry it (the first message is checked; check: :all checks each)",
      fix: "correct the declared type of the stream, or convert the data before",
      meta: %{component: path, input: input.name, originating_time: message.originating_time}
    )
  end
end
