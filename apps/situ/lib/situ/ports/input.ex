defmodule Situ.Ports.Input do
  @moduledoc false
  # One connected input of a running component: its waiting messages under its policy, and the demand it owes its
  # producer. An input whose producer runs in the same process (`producer: nil`) owes none.
  #
  # Under a lossy policy there are two queues: requested messages wait here, the others at the producer (see
  # Subscriber). After a slow callback, the producer is asked for all its messages before the next one is taken, so that
  # the policy applies to everything that was emitted.
  alias Situ.{Delivery, Error, Message, Runtime, Type}
  alias Situ.Delivery.{Batch, Queue}
  alias Situ.Ports.{Address, Counters, DemandWindow}

  @compile {:inline, ask: 2, enter: 2, add_owed: 2}

  @hold_ms 20
  # Asking takes longer than this, so that it costs a part of the throughput only.
  @stale_ns 50_000
  @nothing {0, 0, 0, 0}

  @enforce_keys [:name, :tag, :producer, :window, :counters]
  defstruct [
    :name,
    :tag,
    :producer,
    :window,
    :counters,
    :lossy,
    :held,
    check: :off,
    arrival: {false, nil},
    front: [],
    rear: [],
    handled: @nothing
  ]

  @type entry :: Batch.t() | {:closed, Situ.Time.t()}
  @typedoc """
  `front` and `rear` (reversed) hold what waits under a lossless policy; `lossy` holds the queue of a lossy policy with
  the time at which its messages were known to be the newest, or `:asked`, or `:sure` for the next take. `held` is a
  timer and token while the component pauses the input. `arrival` holds whether the sizes of arriving data are counted,
  and, after a restart of the producer, the time up to which messages have arrived before. `handled` holds the number of
  messages handled but not published, the latency and originating time of the last one, and for how many of them demand
  was sent, because the component still works on them.
  """
  @type t :: %__MODULE__{
          name: atom(),
          tag: term(),
          producer: Address.t() | nil,
          window: DemandWindow.t(),
          counters: Counters.t(),
          lossy: {Queue.t(), integer() | :asked | :sure} | nil,
          held: {reference(), reference()} | nil,
          check: :off | {:first | :all, Type.t()},
          arrival: {sizes? :: boolean(), arrived :: Situ.Time.t() | nil},
          front: [entry()],
          rear: [entry()],
          handled: {non_neg_integer(), integer(), Situ.Time.t(), non_neg_integer()}
        }

  @doc "Builds an input; `opts` holds its `type`, `check`, `counters` and `sizes`."
  @spec new(atom(), term(), Address.t() | nil, Delivery.t(), map()) :: t()
  def new(name, tag, producer, policy, opts) do
    %__MODULE__{
      name: name,
      tag: tag,
      producer: producer,
      window: build_window(producer, policy),
      counters: opts.counters,
      arrival: {opts.sizes, nil},
      check:
        if(:off in [opts.check] or opts.type == :any, do: :off, else: {opts.check, opts.type}),
      lossy: if(Delivery.lossy?(policy), do: {Queue.new(policy), 0})
    }
  end

  defp build_window({:local, _, _}, policy), do: DemandWindow.new_local(policy)
  defp build_window(_producer, policy), do: DemandWindow.new(policy)

  @doc "Changes the address of the producer, which has left the process of the input, or the other way round."
  @spec separate_producer(t(), Address.t()) :: t()
  def separate_producer(%__MODULE__{} = input, address),
    do: %{input | producer: address, window: DemandWindow.apply_limit(input.window)}

  @doc "Requests the first messages from the producer."
  @spec request_first(t()) :: term()
  def request_first(%__MODULE__{} = input), do: ask(input, input.window.size)

  defp ask(%{producer: nil}, _n), do: :ok
  defp ask(input, n), do: Address.send_to_producer(input.producer, input.tag, {:ask, n})

  @doc "Replaces the producer's process."
  @spec replace_producer(t(), Address.t()) :: t()
  def replace_producer(%__MODULE__{lossy: lossy} = input, pid) do
    lossy = with {queue, _fresh} <- lossy, do: {queue, 0}
    {sizes?, _arrived} = input.arrival
    arrival = {sizes?, if(lossy == nil, do: last_time(input))}
    window = DemandWindow.reset_owed(input.window)
    %{input | producer: pid, window: window, lossy: lossy, arrival: arrival}
  end

  # A producer may be killed after it has sent messages, and before it has counted them.
  defp last_time(%{front: front, rear: rear, handled: {n, _latency, time, _}} = input) do
    waiting = Enum.find(rear, &batch?/1) || List.last(Enum.filter(front, &batch?/1))

    cond do
      waiting != nil -> Batch.last_time(waiting)
      n > 0 -> time
      taken_count(input) > 0 -> Counters.last_time(input.counters)
      true -> nil
    end
  end

  defp batch?(entry), do: not match?({:closed, _time}, entry)

  @doc "Adds batches that arrived, and the closing mark of a producer in the same process."
  @spec push(t(), [entry()]) :: t()
  def push(%__MODULE__{} = input, []), do: input

  def push(%__MODULE__{} = input, [{:closed, time} | rest]),
    do: input |> push_closed(time) |> push(rest)

  def push(%__MODULE__{arrival: {sizes?, until}} = input, [batch | rest]) when until != nil do
    case Batch.split_after(batch, until) do
      {_arrived, nil} -> push(input, rest)
      {_arrived, batch} -> push(%{input | arrival: {sizes?, nil}}, [batch | rest])
    end
  end

  def push(%__MODULE__{arrival: {sizes?, nil}} = input, [batch | rest]) do
    if sizes?, do: Counters.count_sizes(input.counters, Batch.data(batch))
    window = DemandWindow.weigh_batch(input.window, batch)
    push(enter(%{input | window: window}, batch), rest)
  end

  defp enter(%{lossy: nil, front: [], rear: []} = input, batch), do: %{input | front: [batch]}
  defp enter(%{lossy: nil} = input, batch), do: %{input | rear: [batch | input.rear]}

  defp enter(%{lossy: {queue, fresh}} = input, batch) do
    {queue, dropped} = Queue.push_all(queue, Batch.messages(batch))
    count_dropped(input, dropped)
    owed = if queue.policy.throttle, do: dropped, else: Batch.size(batch)
    %{input | lossy: {queue, fresh}, window: DemandWindow.add_owed(input.window, owed)}
  end

  @doc "Adds all messages that the producer held back; the waiting messages are then the newest."
  @spec push_refreshed(t(), [Message.t()]) :: t()
  def push_refreshed(%__MODULE__{} = input, messages) do
    input = if messages == [], do: input, else: push(input, [messages])

    with {queue, _fresh} <- input.lossy,
         do: %{input | lossy: {queue, :sure}},
         else: (nil -> input)
  end

  @doc "Adds the closing mark. Waiting messages are dropped if they begin after its time."
  @spec push_closed(t(), Situ.Time.t()) :: t()
  def push_closed(%__MODULE__{lossy: nil} = input, time) do
    input = if late?(input, time), do: input |> discard_all() |> elem(1), else: input
    %{input | rear: [{:closed, time} | input.rear]}
  end

  # The producer has nothing newer to send, and does not reply to a request any more.
  def push_closed(%__MODULE__{lossy: {queue, _fresh}} = input, time) do
    {queue, late} = Queue.push(queue, {:closed, time})
    count_dropped(input, length(late))
    %{input | lossy: {queue, :sure}}
  end

  # An atom is more than any number.
  defp late?(%{front: [], rear: []}, _time), do: false
  defp late?(input, time), do: head_time(%{input | held: nil}) > time

  @doc "Returns whether an entry can be taken."
  @spec has_entry?(t()) :: boolean()
  def has_entry?(%__MODULE__{held: nil, lossy: nil, front: [], rear: []}), do: false
  def has_entry?(%__MODULE__{held: nil, lossy: nil}), do: true
  def has_entry?(%__MODULE__{} = input), do: head_time(input) != :none

  @doc "Returns the originating time of the next entry, or `:none`, also while the input is held."
  @spec head_time(t()) :: Situ.Time.t() | :none
  def head_time(%__MODULE__{held: held}) when held != nil, do: :none
  def head_time(%__MODULE__{lossy: nil, front: [head | _]}), do: entry_time(head)
  def head_time(%__MODULE__{lossy: nil, rear: []}), do: :none
  def head_time(%__MODULE__{lossy: nil, rear: rear}), do: rear |> List.last() |> entry_time()
  def head_time(%__MODULE__{lossy: {_queue, :asked}}), do: :none

  def head_time(%__MODULE__{lossy: {queue, _fresh}}) do
    case Queue.peek(queue) do
      nil -> :none
      {:closed, time} -> time
      message -> message.originating_time
    end
  end

  defp entry_time({:closed, time}), do: time
  defp entry_time(batch), do: Batch.first_time(batch)

  @doc "Prepares to take a message; returns `:wait` if the producer of a lossy input is first asked for newer ones."
  @spec ensure_fresh(t()) :: {:ok | :wait, t()}
  def ensure_fresh(%__MODULE__{lossy: {%{policy: %{throttle: true}}, _fresh}} = input),
    do: {:ok, input}

  def ensure_fresh(%__MODULE__{lossy: {queue, known}} = input) do
    now = Runtime.monotonic_time()

    if known == :sure or now - known < @stale_ns or Counters.held_count(input.counters) == 0 do
      {:ok, %{input | lossy: {queue, now}}}
    else
      Counters.request_held(input.counters)
      Address.request_refresh(input.producer, input.tag)
      {:wait, %{input | lossy: {queue, :asked}}}
    end
  end

  @doc "Takes the next message or the closing mark at clock time `now`."
  @spec pop(t(), Situ.Time.t()) :: {Message.t() | {:closed, Situ.Time.t()} | nil, t()}
  def pop(%__MODULE__{lossy: nil, front: [{:closed, _} = closed | front]} = input, _now),
    do: {closed, %{input | front: front}}

  def pop(%__MODULE__{lossy: nil, front: [batch | front]} = input, _now) do
    {message, rest} = Batch.pop(batch)
    {message, %{input | front: if(rest == nil, do: front, else: [rest | front])}}
  end

  def pop(%__MODULE__{lossy: nil, rear: []} = input, _now), do: {nil, input}
  def pop(%__MODULE__{lossy: nil} = input, now), do: pop(turn_queue(input), now)

  def pop(%__MODULE__{lossy: {queue, fresh}} = input, now) do
    {entry, queue, dropped} = Queue.pop(queue, now)
    n = length(dropped)
    count_dropped(input, n)
    owed = if queue.policy.throttle, do: n + if(entry, do: 1, else: 0), else: 0
    {entry, %{input | lossy: {queue, fresh}, window: DemandWindow.add_owed(input.window, owed)}}
  end

  @doc "Takes up to `n` messages of a lossless input, or `nil` if the closing mark or nothing is next."
  @spec take_batch(t(), pos_integer() | :infinity) :: {Batch.t() | nil, t()}
  def take_batch(%__MODULE__{front: [{:closed, _} | _]} = input, _n), do: {nil, input}

  def take_batch(%__MODULE__{front: [batch | front]} = input, n) do
    {taken, rest} = Batch.split(batch, n)
    {taken, %{input | front: if(rest == nil, do: front, else: [rest | front])}}
  end

  def take_batch(%__MODULE__{rear: []} = input, _n), do: {nil, input}
  def take_batch(%__MODULE__{} = input, n), do: take_batch(turn_queue(input), n)

  defp turn_queue(%{rear: rear} = input), do: %{input | front: :lists.reverse(rear), rear: []}

  @doc "Puts a batch that was taken but not handled back at the front of the queue."
  @spec put_back(t(), Batch.t()) :: t()
  def put_back(%__MODULE__{lossy: nil} = input, batch),
    do: %{input | front: [batch | input.front]}

  @doc "Discards all waiting messages; returns the time of the closing mark if there was one."
  @spec discard_all(t()) :: {Situ.Time.t() | nil, t()}
  def discard_all(%__MODULE__{lossy: nil} = input) do
    entries = input.front ++ :lists.reverse(input.rear)
    {closed, batches} = Enum.split_with(entries, &is_tuple/1)
    n = batches |> Enum.map(&Batch.size/1) |> Enum.sum()
    {closed_time(closed), drop_taken(%{input | front: [], rear: []}, n)}
  end

  def discard_all(%__MODULE__{lossy: {queue, fresh}} = input) do
    {closed, messages} = queue |> Queue.to_list() |> Enum.split_with(&is_tuple/1)
    input = %{input | lossy: {Queue.new(queue.policy), fresh}}
    {closed_time(closed), drop_taken(input, length(messages))}
  end

  defp closed_time([]), do: nil
  defp closed_time([{:closed, time} | _]), do: time

  @doc "Counts `n` messages, the last at `time`, as handled from clock time `now` on."
  @spec count_handled(t(), pos_integer(), Situ.Time.t(), Situ.Time.t()) :: t()
  def count_handled(%__MODULE__{handled: {handled, _, _, requested}} = input, n, time, now),
    do: %{input | handled: {handled + n, now - time, time, requested}}

  @doc """
  Publishes the counts, with `each` ns for a message, and sends demand to the producer when enough is owed. The
  component still works on the last messages of `progress`, `{their number, time of the last finished message or nil}`:
  a process that replaces this one receives them again.
  """
  @spec publish_counts(t(), integer(), {non_neg_integer(), Situ.Time.t() | nil}) :: t()
  def publish_counts(
        %__MODULE__{handled: @nothing, window: %{owed: 0}} = input,
        _each,
        _progress
      ),
      do: input

  def publish_counts(%__MODULE__{} = input, each, {in_progress, finished_until}) do
    %{handled: {n, latency, last, requested}, counters: counters} = input
    kept = min(in_progress, n)
    done = n - kept

    if done > 0 do
      Counters.count_processed(counters, done, latency, each * done)
      reached = if kept == 0, do: last, else: finished_until
      if reached, do: Counters.record_reached(counters, reached, last + latency)
    end

    input = if input.lossy == nil, do: add_owed(input, n - requested), else: input
    {asked, window} = DemandWindow.take_owed(input.window)
    if asked > 0, do: ask(input, asked)
    handled = if kept == 0, do: @nothing, else: {kept, latency, last, kept}
    %{input | handled: handled, window: window}
  end

  defp add_owed(input, n), do: %{input | window: DemandWindow.add_owed(input.window, n)}

  @doc "Publishes the last counts of an input that has closed, and acknowledges its end to the producer."
  @spec acknowledge_end(t(), integer()) :: term()
  def acknowledge_end(%__MODULE__{producer: producer, tag: tag} = input, each) do
    publish_counts(input, each, {0, nil})
    if producer, do: Address.acknowledge_end(producer, tag)
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
    count_dropped(input, n)
    if input.lossy, do: input, else: add_owed(input, n)
  end

  defp count_dropped(_input, 0), do: :ok
  defp count_dropped(input, n), do: Counters.count_dropped(input.counters, n)

  @doc "Sets the function that decides which messages a lossy input never drops."
  @spec put_guarantee(t(), (term() -> boolean())) :: t()
  def put_guarantee(%__MODULE__{lossy: nil} = input, _keep?), do: input

  def put_guarantee(%__MODULE__{lossy: {queue, fresh}} = input, keep?),
    do: %{input | lossy: {Queue.put_guarantee(queue, keep?), fresh}}

  @doc "Pauses the input for 20 ms or until it is resumed; pausing it again restarts the time."
  @spec set_hold(t(), boolean()) :: t()
  def set_hold(%__MODULE__{} = input, held?) do
    with {timer, _token} <- input.held, do: Runtime.cancel_timer(timer)
    %{input | held: if(held?, do: start_hold(input.tag))}
  end

  defp start_hold(tag) do
    token = make_ref()
    {Runtime.send_after({:situ_hold, tag, token}, @hold_ms), token}
  end

  @doc "Checks that the data has the input's type, as `check` requires; a first valid message ends `:first`."
  @spec check_type(t(), Message.t(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def check_type(%__MODULE__{check: :off} = input, _message, _path), do: {:ok, input}

  def check_type(%__MODULE__{check: {check, type}} = input, message, path) do
    cond do
      not Type.valid_value?(type, message.data) -> {:error, wrong_type(input, message, path)}
      check == :first -> {:ok, %{input | check: :off}}
      true -> {:ok, input}
    end
  end

  defp wrong_type(%{check: {_check, type}} = input, message, path) do
    data = inspect(message.data, limit: 8, printable_limit: 80)

    Error.new(
      :wrong_data,
      "#{path}.#{input.name} takes #{Type.to_string(type)}, got: #{data}",
      why:
        "the stream was declared to carry it (the first message is checked; check: :all checks each)",
      fix: "correct the declared type of the stream, or convert the data before",
      meta: %{component: path, input: input.name, originating_time: message.originating_time}
    )
  end
end
