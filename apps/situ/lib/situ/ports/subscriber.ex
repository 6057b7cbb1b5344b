defmodule Situ.Ports.Subscriber do
  @moduledoc false
  # One consumer of an output: its demand and its waiting messages. Under a lossy policy the policy's queue is here, at
  # the producer, so a slow consumer receives no more than it asked for.
  #
  # A consumer is another stage of the pipeline, which takes batches; another step of the same stage (`demand: :local`),
  # for which the stage collects them with `take_buffer/1`; or a GenStage process, which takes messages and may be
  # watched by `monitor`.
  #
  # If the policy redelivers, `unacked` holds the messages that were sent but not handled yet, according to the
  # consumer's counters. A process that replaces a dead consumer receives them again. Conversely, a process that
  # replaces a dead producer skips messages up to the last one that was sent (`resume`).
  #
  # After the closing mark, the subscriber of another stage remains until the consumer acknowledges the end of its input
  # (`Address.acknowledge_end/2`). A process that replaces the consumer until then receives the messages that were not
  # handled, and the mark again.
  # See docs/adr/0140-lossy-queues-are-at-the-producer.md.
  alias Situ.Delivery
  alias Situ.Delivery.{Batch, Queue}
  alias Situ.Ports.{Address, Counters}

  @compile {:inline, send_entry: 2, send_batches: 3, retain_batches: 2, subtract: 2, deliver: 4}

  @enforce_keys [:tag, :pid]
  defstruct [
    :tag,
    :pid,
    :counters,
    :monitor,
    :queue,
    :unacked,
    :resume,
    demand: 0,
    buffer: [],
    rear: [],
    size: 0,
    waiting: false
  ]

  @typedoc """
  `buffer` and `rear` (reversed) hold batches that wait for demand, `queue` the same under a lossy policy. `unacked` is
  the number of messages that the consumer is known to have handled, and the batches after them. After the closing mark,
  `demand` holds its time.
  """
  @type t :: %__MODULE__{
          tag: term(),
          pid: Address.t(),
          counters: Counters.t() | nil,
          monitor: reference() | nil,
          queue: Queue.t() | nil,
          unacked: {non_neg_integer(), :queue.queue(Batch.t())} | nil,
          resume: Situ.Time.t() | nil,
          demand: integer() | :infinity | :local | {:closed, Situ.Time.t()},
          buffer: [Batch.t()],
          rear: [Batch.t()],
          size: non_neg_integer(),
          waiting: boolean()
        }

  @doc "Builds a subscriber without demand."
  @spec new(term(), Address.t(), Counters.t() | nil, Delivery.t() | nil) :: t()
  def new(tag, pid, counters, policy \\ nil) do
    if counters, do: Counters.put_held_count(counters, 0)
    lossy? = policy != nil and Delivery.lossy?(policy)
    redeliver? = policy != nil and policy.on_restart == :redeliver and not lossy?

    %__MODULE__{
      tag: tag,
      pid: pid,
      counters: counters,
      queue: if(lossy?, do: Queue.new(policy)),
      unacked: if(redeliver?, do: {0, :queue.new()})
    }
  end

  @doc "Builds a subscriber for another step of the calling stage."
  @spec new_local(term(), Address.t(), Counters.t()) :: t()
  def new_local(tag, address, counters), do: %{new(tag, address, counters) | demand: :local}

  @doc "Replaces the consumer's process; the new process has no demand."
  @spec replace_consumer(t(), Address.t()) :: t()
  # A producer that was restarted at the same time has known this process from the start.
  # It may have missed the mark, which is sent regardless of demand, while it was starting.
  def replace_consumer(%__MODULE__{pid: pid} = sub, pid) do
    with {:closed, time} <- sub.demand, do: send_close(sub, time)
    sub
  end

  def replace_consumer(%__MODULE__{demand: {:closed, time}} = sub, pid) do
    sub = replace_consumer(%{sub | demand: 0}, pid)
    [sub] = sub |> add_demand(:infinity) |> close_drained(time)
    sub
  end

  def replace_consumer(%__MODULE__{unacked: nil} = sub, pid) do
    {emitted, processed, dropped} = Counters.flow_counts(sub.counters)
    count_dropped(sub, max(emitted - sub.size - processed - dropped, 0))
    %{sub | pid: pid, demand: 0}
  end

  def replace_consumer(%__MODULE__{} = sub, pid) do
    %{unacked: {handled, queue}} = sub = forget_handled(sub)
    batches = :queue.to_list(queue)
    n = batches |> Enum.map(&Batch.size/1) |> Enum.sum()
    Counters.count_handed(sub.counters, -n, 0)
    sub = %{sub | unacked: {handled, :queue.new()}, buffer: batches ++ sub.buffer}
    %{sub | pid: pid, demand: 0, size: sub.size + n}
  end

  @doc "Continues after the messages that a dead producer had sent to the consumer."
  @spec resume_after_restart(t()) :: t()
  def resume_after_restart(%__MODULE__{queue: nil, counters: counters} = sub) do
    {handed, time} = Counters.forget_unsent(counters)
    unacked = with {_, queue} <- sub.unacked, do: {handed, queue}
    %{sub | unacked: unacked, resume: if(handed > 0, do: time)}
  end

  def resume_after_restart(%__MODULE__{} = sub), do: sub

  # Forgets the messages that the consumer has handled.
  defp forget_handled(%{unacked: {known, queue}} = sub) do
    {_emitted, processed, dropped} = Counters.flow_counts(sub.counters)
    handled = processed + dropped

    if handled > known,
      do: %{sub | unacked: {handled, drop_first(queue, handled - known)}},
      else: sub
  end

  defp forget_handled(sub), do: sub

  defp drop_first(queue, 0), do: queue

  defp drop_first(queue, n) do
    case :queue.out(queue) do
      {:empty, queue} ->
        queue

      {{:value, batch}, rest} ->
        case Batch.split(batch, n) do
          {batch, nil} -> drop_first(rest, n - Batch.size(batch))
          {_handled, batch} -> :queue.in_r(batch, rest)
        end
    end
  end

  @doc """
  Sends the closing mark, unless messages wait for demand. Returns the subscriber if it remains: until its messages are
  sent, or until another stage has acknowledged the mark.
  """
  @spec close_drained(t(), Situ.Time.t()) :: [t()]
  def close_drained(%__MODULE__{size: size} = sub, _time) when size > 0, do: [sub]
  def close_drained(%__MODULE__{demand: {:closed, _time}} = sub, _again), do: [sub]

  def close_drained(%__MODULE__{} = sub, time) do
    send_close(sub, time)

    if sub.counters == nil or sub.demand == :local,
      do: [],
      else: [%{sub | demand: {:closed, time}}]
  end

  @spec closed?(t()) :: boolean()
  def closed?(%__MODULE__{demand: demand}), do: is_tuple(demand)

  @doc "Sends the closing mark, after the last message."
  @spec send_close(t(), Situ.Time.t()) :: term()
  def send_close(sub, time), do: send_cancel(sub, {:shutdown, {:closed, time}})

  @doc "Sends the end of the subscription."
  @spec send_cancel(t(), term()) :: term()
  def send_cancel(sub, reason),
    do: Address.send_to_consumer(sub.pid, sub.tag, {:cancel, reason})

  @doc """
  Delivers batches of `n` messages at clock time `now` within the demand; the rest waits. `latency` is the originating
  time of the last message and its age, in ns, when it was created.
  """
  @spec deliver_batches(
          t(),
          [Batch.t()],
          pos_integer(),
          {Situ.Time.t(), integer()},
          Situ.Time.t()
        ) ::
          t()
  def deliver_batches(%{demand: {:closed, _time}} = sub, _batches, _n, _latency, _now), do: sub

  def deliver_batches(%{resume: until} = sub, batches, _n, latency, now) when until != nil do
    case Enum.flat_map(batches, &batches_after(&1, until)) do
      [] ->
        sub

      batches ->
        n = batches |> Enum.map(&Batch.size/1) |> Enum.sum()
        deliver_batches(%{sub | resume: nil}, batches, n, latency, now)
    end
  end

  def deliver_batches(sub, batches, n, {time, created}, now) do
    if sub.counters do
      Counters.count_emitted(sub.counters, n, created, now - time)
      Counters.record_sent(sub.counters, time, now)
    end

    deliver(sub, batches, n, now)
  end

  defp batches_after(batch, until) do
    case Batch.split_after(batch, until) do
      {_sent, nil} -> []
      {_sent, batch} -> [batch]
    end
  end

  defp deliver(%{demand: :local} = sub, batches, n, _now),
    do: %{sub | rear: :lists.reverse(batches, sub.rear), size: sub.size + n}

  defp deliver(%{size: 0, demand: demand} = sub, batches, n, _now)
       when demand == :infinity or demand >= n,
       do: send_batches(%{sub | demand: subtract(demand, n)}, batches, n)

  defp deliver(%{queue: nil} = sub, batches, n, _now),
    do: send_waiting(%{sub | rear: :lists.reverse(batches, sub.rear), size: sub.size + n})

  defp deliver(sub, batches, _n, now) do
    {queue, expired} = Queue.drop_expired(sub.queue, now)
    {queue, dropped} = Queue.push_all(queue, Enum.flat_map(batches, &Batch.messages/1))
    count_dropped(sub, length(expired) + dropped)
    sub = %{sub | queue: queue, size: queue.size}

    # In the middle of a turn: the consumer need not wait until this stage looks into its mailbox.
    if sub.counters != nil and Counters.take_held_request?(sub.counters),
      do: hand_over(sub),
      else: send_waiting(sub)
  end

  @doc "Takes the batches for another step of the same stage."
  @spec take_buffer(t()) :: {[Batch.t()], t()}
  def take_buffer(%__MODULE__{demand: :local, rear: rear} = sub),
    do: {:lists.reverse(rear), %{sub | rear: [], size: 0}}

  @doc "Adds demand."
  @spec add_demand(t(), pos_integer() | :infinity) :: t()
  def add_demand(%__MODULE__{demand: {:closed, _time}} = sub, _n), do: forget_handled(sub)

  def add_demand(%__MODULE__{demand: demand} = sub, n) do
    demand = if :infinity in [demand, n], do: :infinity, else: demand + n
    send_waiting(forget_handled(%{sub | demand: demand}))
  end

  @doc "Delivers all messages waiting under a lossy policy, unless already done; the batch may be empty."
  @spec deliver_newest(t()) :: t()
  def deliver_newest(%__MODULE__{queue: queue, counters: counters} = sub) do
    if queue != nil and Counters.take_held_request?(counters), do: hand_over(sub), else: sub
  end

  defp hand_over(%{queue: queue} = sub) do
    put_held(sub, 0)
    send_entry(sub, {:fresh, Queue.to_list(queue)})
    %{sub | queue: Queue.new(queue.policy), size: 0}
  end

  @doc "Discards waiting messages later than the closing time, under a lossy policy."
  @spec drop_after(t(), Situ.Time.t()) :: t()
  def drop_after(%__MODULE__{queue: nil} = sub, _time), do: sub

  def drop_after(%__MODULE__{} = sub, time) do
    {queue, late} = Queue.drop_after(sub.queue, time)
    count_dropped(sub, length(late))
    %{sub | queue: queue, size: queue.size}
  end

  @doc "Returns the free demand; negative while messages wait, `:infinity` if the policy drops without throttling."
  @spec free_capacity(t()) :: integer() | :infinity
  def free_capacity(%{demand: demand}) when not is_integer(demand), do: :infinity
  def free_capacity(%{queue: %{policy: %{throttle: false}}}), do: :infinity
  def free_capacity(%{size: 0, demand: demand}), do: demand
  def free_capacity(%{size: size}), do: -size

  @doc "Sets the function that decides which messages a lossy policy never drops."
  @spec put_guarantee(t(), (term() -> boolean())) :: t()
  def put_guarantee(%__MODULE__{queue: nil} = sub, _keep?), do: sub

  def put_guarantee(%__MODULE__{queue: queue} = sub, keep?),
    do: %{sub | queue: Queue.put_guarantee(queue, keep?)}

  defp send_waiting(%{size: 0} = sub), do: note_waiting(sub, false)
  defp send_waiting(%{demand: 0} = sub), do: note_waiting(sub, true)

  defp send_waiting(%{queue: nil, buffer: [], rear: rear} = sub),
    do: send_waiting(%{sub | buffer: :lists.reverse(rear), rear: []})

  defp send_waiting(%{queue: nil, demand: demand} = sub) do
    {batches, n, rest} = take_within(sub.buffer, demand, [], 0)
    sub = %{sub | buffer: rest, size: sub.size - n, demand: subtract(demand, n)}
    sub |> send_batches(batches, n) |> send_waiting()
  end

  # Protected messages may be more than were asked for.
  defp send_waiting(%{queue: queue, demand: demand} = sub) do
    {messages, n, queue} = Queue.take(queue, demand)
    sub = %{sub | queue: queue, size: queue.size, demand: subtract(demand, n)}
    sub = if messages == [], do: sub, else: send_batches(sub, [messages], n)
    note_waiting(sub, sub.size > 0)
  end

  defp take_within([], _demand, taken, n), do: {:lists.reverse(taken), n, []}
  defp take_within(rest, demand, taken, n) when n == demand, do: {:lists.reverse(taken), n, rest}

  defp take_within([batch | rest], demand, taken, n) do
    {now, later} = Batch.split(batch, subtract(demand, n))
    rest = if later == nil, do: rest, else: [later | rest]
    take_within(rest, demand, [now | taken], n + Batch.size(now))
  end

  # Only the stages of a pipeline have counters for their connections.
  defp send_batches(%{counters: nil} = sub, batches, _n) do
    send_entry(sub, Enum.flat_map(batches, &Batch.messages/1))
    sub
  end

  defp send_batches(sub, batches, n) do
    send_entry(sub, batches)
    Counters.count_handed(sub.counters, n, Batch.last_time(:lists.last(batches)))
    retain_batches(sub, batches)
  end

  defp retain_batches(%{unacked: nil} = sub, _batches), do: sub

  defp retain_batches(%{unacked: {handled, queue}} = sub, batches),
    do: %{sub | unacked: {handled, Enum.reduce(batches, queue, &:queue.in/2)}}

  defp send_entry(sub, entry), do: Address.send_to_consumer(sub.pid, sub.tag, entry)

  # Nobody waits for a lossy edge: its flag is how much is held back.
  defp note_waiting(%{queue: queue} = sub, _flag) when queue != nil do
    put_held(sub, sub.size)
    sub
  end

  defp note_waiting(%{waiting: same} = sub, same), do: sub
  defp note_waiting(%{counters: nil} = sub, _flag), do: sub

  defp note_waiting(sub, flag) do
    Counters.set_waiting(sub.counters, if(flag, do: 1, else: 0))
    %{sub | waiting: flag}
  end

  defp put_held(%{counters: nil}, _n), do: :ok
  defp put_held(%{counters: counters}, n), do: Counters.put_held_count(counters, n)

  defp count_dropped(_sub, 0), do: :ok
  defp count_dropped(%{counters: nil}, _n), do: :ok
  defp count_dropped(%{counters: counters}, n), do: Counters.count_dropped(counters, n)

  defp subtract(:infinity, _n), do: :infinity
  defp subtract(demand, n), do: demand - n
end
