defmodule Situ.Ports.Subscriber do
  @moduledoc false
  # One consumer of an output: its demand and its waiting messages. Under a lossy policy the policy's queue is here, at
  # the producer, so a slow consumer receives no more than it asked for. `monitor` watches a consumer outside the
  # pipeline.
  # See docs/adr/0140-lossy-queues-are-at-the-producer.md.
  alias Situ.Delivery
  alias Situ.Delivery.Queue
  alias Situ.Ports.Counters

  @enforce_keys [:tag, :pid]
  defstruct [
    :tag,
    :pid,
    :counters,
    :monitor,
    :queue,
    demand: 0,
    buffer: [],
    rear: [],
    size: 0,
    waiting: false
  ]

  @typedoc "`buffer` and `rear` (reversed): batches that wait for demand; `queue`: the same under a lossy policy."
  @type t :: %__MODULE__{
          tag: term(),
          pid: pid(),
          counters: Counters.t() | nil,
          monitor: reference() | nil,
          queue: Queue.t() | nil,
          demand: integer() | :infinity,
          buffer: [[Situ.Message.t()]],
          rear: [[Situ.Message.t()]],
          size: non_neg_integer(),
          waiting: boolean()
        }

  @type ages :: {Situ.Time.t(), created :: integer(), posted :: integer()}

  @doc "Builds a subscriber without demand."
  @spec new(term(), pid(), Counters.t() | nil, Delivery.t() | nil) :: t()
  def new(tag, pid, counters, policy \\ nil) do
    if counters, do: Counters.put_held_count(counters, 0)
    lossy? = policy != nil and Delivery.lossy?(policy)
    queue = if lossy?, do: Queue.new(policy)
    %__MODULE__{tag: tag, pid: pid, counters: counters, queue: queue}
  end

  @doc "Replaces the consumer's process; the new process has no demand."
  @spec replace_consumer(t(), pid()) :: t()
  def replace_consumer(%__MODULE__{} = sub, pid), do: %{sub | pid: pid, demand: 0}

  @doc "Sends the closing mark, after the last message."
  @spec send_close(t(), Situ.Time.t()) :: term()
  def send_close(sub, time), do: send_cancel(sub, {:shutdown, {:closed, time}})

  @doc "Sends the end of the subscription."
  @spec send_cancel(t(), term()) :: term()
  def send_cancel(sub, reason),
    do: send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, {:cancel, reason}})

  @doc """
  Delivers `n` messages at clock time `now` within the demand; the rest waits. `ages` is the time of the last message,
  and its age, in ns, when it was created and when it was posted.
  """
  @spec deliver_messages(t(), [Situ.Message.t()], pos_integer(), ages(), Situ.Time.t()) :: t()
  def deliver_messages(%{size: 0, demand: demand} = sub, messages, n, ages, now)
      when demand == :infinity or demand >= n do
    count(sub, n, ages, now)
    deliver(sub, messages)
    %{sub | demand: minus(demand, n)}
  end

  def deliver_messages(%{queue: nil} = sub, messages, n, ages, now) do
    count(sub, n, ages, now)
    drain(%{sub | rear: [messages | sub.rear], size: sub.size + n})
  end

  def deliver_messages(sub, messages, n, ages, now) do
    count(sub, n, ages, now)
    {queue, old} = Queue.drop_expired(sub.queue, now)
    {queue, dropped} = Queue.push_all(queue, messages)
    drop(sub, length(old) + dropped)
    sub = %{sub | queue: queue, size: queue.size}
    # In the middle of a turn: the consumer need not wait until this stage looks into its mailbox.
    if sub.counters != nil and Counters.take_held_request?(sub.counters),
      do: hand_over(sub),
      else: drain(sub)
  end

  @doc "Adds demand."
  @spec add_demand(t(), pos_integer() | :infinity) :: t()
  def add_demand(%__MODULE__{} = sub, n), do: drain(%{sub | demand: more(sub.demand, n)})

  @doc "Delivers all messages waiting under a lossy policy, unless already done; the batch may be empty."
  @spec deliver_newest(t()) :: t()
  def deliver_newest(%__MODULE__{queue: queue, counters: counters} = sub) do
    if queue != nil and Counters.take_held_request?(counters), do: hand_over(sub), else: sub
  end

  defp hand_over(%{queue: queue} = sub) do
    put_held(sub, 0)
    send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, {:fresh, Queue.to_list(queue)}})
    %{sub | queue: Queue.new(queue.policy), size: 0}
  end

  @doc "Discards waiting messages later than the closing time, under a lossy policy."
  @spec drop_after(t(), Situ.Time.t()) :: t()
  def drop_after(%__MODULE__{queue: nil} = sub, _time), do: sub

  def drop_after(%__MODULE__{} = sub, time) do
    {queue, late} = Queue.drop_after(sub.queue, time)
    drop(sub, length(late))
    %{sub | queue: queue, size: queue.size}
  end

  defp drain(%{size: 0} = sub), do: note_waiting(sub, false)
  defp drain(%{demand: 0} = sub), do: note_waiting(sub, true)

  defp drain(%{queue: nil, buffer: [], rear: rear} = sub),
    do: drain(%{sub | buffer: Enum.reverse(rear), rear: []})

  defp drain(%{queue: nil, buffer: [batch | rest], demand: demand} = sub) do
    {now, later} = split(batch, demand)
    n = length(now)
    deliver(sub, now)
    buffer = if later == [], do: rest, else: [later | rest]
    drain(%{sub | buffer: buffer, size: sub.size - n, demand: minus(demand, n)})
  end

  defp drain(%{queue: queue, demand: demand} = sub) do
    {now, n, queue} = Queue.take(queue, demand)
    put_held(sub, queue.size)
    deliver(sub, now)
    drain_rest(%{sub | queue: queue, size: queue.size, demand: minus(demand, n)})
  end

  # Protected messages may be more than were asked for.
  defp drain_rest(sub), do: note_waiting(sub, sub.size > 0)

  defp deliver(sub, messages), do: send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, messages})

  defp split(batch, :infinity), do: {batch, []}
  defp split(batch, n), do: Enum.split(batch, n)

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

  defp drop(_sub, 0), do: :ok
  defp drop(%{counters: nil}, _n), do: :ok
  defp drop(%{counters: counters}, n), do: Counters.count_dropped(counters, n)

  defp count(%{counters: nil}, _n, _ages, _now), do: :ok

  defp count(%{counters: counters}, n, {time, created, posted}, now) do
    Counters.count_emitted(counters, n, created, posted)
    Counters.record_sent(counters, time, now)
  end

  @doc "Returns the free demand; negative while messages wait, `:infinity` if the policy drops without throttling."
  @spec free_capacity(t()) :: integer() | :infinity
  def free_capacity(%{demand: :infinity}), do: :infinity
  def free_capacity(%{queue: %{policy: %{throttle: false}}}), do: :infinity
  def free_capacity(%{size: 0, demand: demand}), do: demand
  def free_capacity(%{size: size}), do: -size

  defp minus(:infinity, _n), do: :infinity
  defp minus(demand, n), do: demand - n
  defp more(:infinity, _n), do: :infinity
  defp more(_demand, :infinity), do: :infinity
  defp more(demand, n), do: demand + n
end
