defmodule Situ.Ports.Output do
  @moduledoc false
  # One output of a running component: its posting state (see Posting), messages that wait for their time, and
  # subscribers. Only `flush/1`, `add_demand/3`, `refresh_subscriber/2` and `close/2` send messages.
  alias Situ.Delivery.Queue
  alias Situ.Message
  alias Situ.Ports.Subscriber

  @nothing {[], []}

  @enforce_keys [:port]
  defstruct [
    :port,
    :last_time,
    :last_creation,
    :closing,
    :wanted,
    :mark,
    :resume,
    seq: 0,
    posted: 0,
    pending: [],
    pending_n: 0,
    future: @nothing,
    closed: false,
    waits: false,
    repeated: 0,
    subs: []
  ]

  @typedoc "An item that waits for its time: data with its time, or a message with its own envelope."
  @type held :: {Situ.Time.t(), term()} | Message.t()
  @typedoc "The constant part: name, the component's path, the stream's id, and the rule for equal times."
  @type port_of :: %{
          name: atom(),
          path: String.t(),
          source_id: non_neg_integer(),
          same_time: :error | :drop | :nudge
        }

  @typedoc """
  `last_time`, `last_creation` and `seq` belong to the last message created; `posted` is the clock at that moment.
  `pending` is sent with the next flush, newest first; `future` (front and reversed rear) waits for the clock.
  `closing` is the closing time; `closed` is true once all subscribers know it. `waits` withholds everything until the
  pipeline knows that the source ends. Messages up to `resume` were posted before a restart; `repeated` counts them.
  `wanted` is for nudged times (see Posting). `mark` is the shared memory of `new_marks/1`.
  """
  @type t :: %__MODULE__{
          port: port_of(),
          last_time: Situ.Time.t() | nil,
          last_creation: Situ.Time.t() | nil,
          closing: Situ.Time.t() | nil,
          wanted: {Situ.Time.t(), Situ.Time.t()} | nil,
          mark: {marks(), non_neg_integer()} | nil,
          resume: Situ.Time.t() | nil,
          seq: non_neg_integer(),
          posted: Situ.Time.t(),
          pending: [Message.t()],
          pending_n: non_neg_integer(),
          future: {[held()], [held()]},
          closed: boolean(),
          waits: boolean(),
          repeated: non_neg_integer(),
          subs: [Subscriber.t()]
        }
  @type marks :: :atomics.atomics_ref()

  @doc "Builds an output without subscribers."
  @spec new(atom(), String.t(), non_neg_integer(), :error | :drop | :nudge) :: t()
  def new(name, path, source_id, same_time \\ :error) do
    port = %{name: name, path: path, source_id: source_id, same_time: same_time}
    %__MODULE__{port: port}
  end

  @doc """
  Creates shared memory for the progress of this many outputs, so that a process that replaces a dead one continues from
  there.
  """
  @spec new_marks(non_neg_integer()) :: marks()
  def new_marks(outputs), do: :atomics.new(max(outputs, 1) * 3, signed: true)

  @doc "Attaches the output to its entry in `marks`; it continues from the previous progress and records its own."
  @spec attach_marks(t(), marks() | nil, non_neg_integer()) :: t()
  def attach_marks(output, nil, _index), do: output

  def attach_marks(%__MODULE__{} = output, marks, index) do
    output = %{output | mark: {marks, index}}

    case :atomics.get(marks, index * 3 + 3) do
      0 ->
        output

      seq ->
        time = :atomics.get(marks, index * 3 + 1)
        creation = :atomics.get(marks, index * 3 + 2)
        resume_after_restart(%{output | last_time: time, last_creation: creation, seq: seq})
    end
  end

  @doc "Records `message` as the last one sent."
  @spec note_sent(t(), Message.t()) :: :ok
  def note_sent(%__MODULE__{mark: nil}, _message), do: :ok

  def note_sent(%__MODULE__{mark: {marks, index}}, message) do
    :atomics.put(marks, index * 3 + 1, message.originating_time)
    :atomics.put(marks, index * 3 + 2, message.creation_time)
    :atomics.put(marks, index * 3 + 3, message.sequence_id)
  end

  @doc "Sets the function that decides which messages the subscriber `tag` never loses."
  @spec put_guarantee(t(), term(), (term() -> boolean())) :: t()
  def put_guarantee(%__MODULE__{} = output, tag, keep?) do
    subs =
      Enum.map(output.subs, fn
        %{tag: ^tag, queue: queue} = sub when queue != nil ->
          %{sub | queue: Queue.put_guarantee(queue, keep?)}

        sub ->
          sub
      end)

    %{output | subs: subs}
  end

  @doc "Marks messages up to the last time as already posted, because the component restarts."
  @spec resume_after_restart(t()) :: t()
  def resume_after_restart(%__MODULE__{} = output), do: %{output | resume: output.last_time}

  @doc "Returns whether messages wait for their time."
  @spec messages_held?(t()) :: boolean()
  def messages_held?(%__MODULE__{future: future}), do: future != @nothing

  @doc "Returns the time of the next held message, or `nil`."
  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{future: {[], _}}), do: nil
  def next_time(%__MODULE__{future: {[first | _], _}}), do: time_of(first)

  @doc "Holds an item back until its time."
  @spec hold_item(t(), held()) :: t()
  def hold_item(%__MODULE__{future: {[], []}} = output, item),
    do: %{output | future: {[item], []}}

  def hold_item(%__MODULE__{future: {front, rear}} = output, item),
    do: %{output | future: {front, [item | rear]}}

  @doc "Takes the first held item that is due at `now`."
  @spec pop_due(t(), Situ.Time.t()) :: {held(), t()} | nil
  def pop_due(%__MODULE__{future: {[], _}}, _now), do: nil

  def pop_due(%__MODULE__{future: {[first | front], rear}} = output, now) do
    if time_of(first) <= now, do: {first, %{output | future: balance(front, rear)}}
  end

  defp balance([], rear), do: {:lists.reverse(rear), []}
  defp balance(front, rear), do: {front, rear}

  @doc "Discards held messages later than `final`."
  @spec drop_held_after(t(), Situ.Time.t()) :: t()
  def drop_held_after(%__MODULE__{future: @nothing} = output, _final), do: output

  def drop_held_after(%__MODULE__{future: {front, rear}} = output, final),
    do: %{
      output
      | future: {Enum.filter(front ++ Enum.reverse(rear), &(time_of(&1) <= final)), []}
    }

  @doc "Discards all held messages."
  @spec drop_all_held(t()) :: t()
  def drop_all_held(%__MODULE__{} = output), do: %{output | future: @nothing}

  @doc "Returns how many messages may be posted: the smallest demand of its subscribers minus buffered messages."
  @spec available_room(t()) :: integer() | :infinity
  def available_room(%__MODULE__{subs: []}), do: :infinity
  def available_room(%__MODULE__{closed: true}), do: :infinity

  def available_room(%__MODULE__{subs: [sub], pending_n: n}),
    do: less(Subscriber.free_capacity(sub), n)

  def available_room(%__MODULE__{subs: subs, pending_n: n}),
    do: subs |> least_capacity(:infinity) |> less(n)

  # Below one there is no room, however little the others have.
  defp least_capacity(_subs, least) when least < 1, do: least
  defp least_capacity([], least), do: least

  defp least_capacity([sub | rest], least),
    do: least_capacity(rest, min(Subscriber.free_capacity(sub), least))

  @doc "Sets whether pending messages and the closing mark are withheld for now."
  @spec set_waiting(t(), boolean()) :: t()
  def set_waiting(%__MODULE__{} = output, waits?), do: %{output | waits: waits?}

  @doc "Adds a reversed batch that a chain has built, newest first."
  @spec push_reversed(t(), [Message.t()], non_neg_integer()) :: t()
  def push_reversed(%__MODULE__{pending: []} = output, reversed, n),
    do: %{output | pending: reversed, pending_n: n}

  def push_reversed(%__MODULE__{} = output, reversed, n),
    do: %{output | pending: reversed ++ output.pending, pending_n: output.pending_n + n}

  @doc "Delivers pending messages to the subscribers within their demand, and the closing marks that follow them."
  @spec flush(t()) :: t()
  def flush(%__MODULE__{pending: [], closing: nil} = output), do: output
  def flush(%__MODULE__{waits: true} = output), do: output
  def flush(%__MODULE__{pending: []} = output), do: finish(output)
  def flush(%__MODULE__{subs: []} = output), do: finish(%{output | pending: [], pending_n: 0})

  def flush(%__MODULE__{pending: [last | _], pending_n: n, posted: posted} = output) do
    messages = if n == 1, do: output.pending, else: :lists.reverse(output.pending)
    note_sent(output, last)
    time = last.originating_time
    ages = {time, last.creation_time - time, posted - time}
    subs = give(output.subs, messages, n, ages, posted)
    finish(%{output | pending: [], pending_n: 0, subs: subs})
  end

  defp give([], _messages, _n, _ages, _now), do: []

  defp give([sub | rest], messages, n, ages, now),
    do: [
      Subscriber.deliver_messages(sub, messages, n, ages, now)
      | give(rest, messages, n, ages, now)
    ]

  @doc "Adds demand of the subscriber with this pid and tag. Returns `:error` for an unknown subscriber."
  @spec add_demand(t(), {pid(), term()}, pos_integer() | :infinity) :: {:ok, t()} | :error
  def add_demand(%__MODULE__{subs: [%{pid: pid, tag: tag} = sub]} = output, {pid, tag}, n),
    do: {:ok, finish(%{output | subs: [Subscriber.add_demand(sub, n)]})}

  def add_demand(%__MODULE__{subs: subs} = output, from, n) do
    case ask_one(subs, from, n) do
      :error -> :error
      subs -> {:ok, finish(%{output | subs: subs})}
    end
  end

  defp ask_one([], _from, _n), do: :error

  defp ask_one([%{tag: tag, pid: pid} = sub | rest], {pid, tag}, n),
    do: [Subscriber.add_demand(sub, n) | rest]

  defp ask_one([sub | rest], from, n) do
    case ask_one(rest, from, n) do
      :error -> :error
      rest -> [sub | rest]
    end
  end

  @doc "Sends a subscriber with a lossy policy the newest messages immediately, whatever its demand."
  @spec refresh_subscriber(t(), {pid(), term()}) :: t()
  def refresh_subscriber(%__MODULE__{} = output, from),
    do: finish(%{output | subs: update(output.subs, from, &Subscriber.deliver_newest/1)})

  @doc "Returns whether a subscriber has this pid and tag."
  @spec has_subscriber?(t(), {pid(), term()}) :: boolean()
  def has_subscriber?(%__MODULE__{subs: subs}, from), do: among?(subs, from)

  defp among?([], _from), do: false
  defp among?([%{tag: tag, pid: pid} | _], {pid, tag}), do: true
  defp among?([_sub | rest], from), do: among?(rest, from)

  defp update([], _from, _fun), do: []
  defp update([%{tag: tag, pid: pid} = sub | rest], {pid, tag}, fun), do: [fun.(sub) | rest]
  defp update([sub | rest], from, fun), do: [sub | update(rest, from, fun)]

  @doc "Closes the output; the closing mark is sent after all messages before it."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{closing: nil} = output, time) do
    output = drop_held_after(%{output | closing: time}, time)
    flush(%{output | subs: Enum.map(output.subs, &Subscriber.drop_after(&1, time))})
  end

  def close(%__MODULE__{} = output, _time), do: output

  @doc "Adds a subscriber to a running output; a closed output sends the closing mark instead."
  @spec subscribe(t(), Subscriber.t()) :: t()
  def subscribe(%__MODULE__{closed: true} = output, sub) do
    Subscriber.send_close(sub, output.closing)
    output
  end

  def subscribe(%__MODULE__{} = output, sub), do: %{output | subs: output.subs ++ [sub]}

  @doc "Removes subscribers and the messages that wait for them."
  @spec cancel_subscribers(t(), (Subscriber.t() -> boolean())) :: t()
  def cancel_subscribers(%__MODULE__{} = output, which?) do
    finish(%{output | subs: Enum.reject(output.subs, which?)})
  end

  @doc "Returns how many messages wait for demand."
  @spec buffered_count(t()) :: non_neg_integer()
  def buffered_count(%__MODULE__{} = output),
    do: Enum.reduce(output.subs, output.pending_n, &max(&1.size, &2))

  defp finish(%{closing: nil} = output), do: output
  defp finish(%{closed: true} = output), do: output
  defp finish(%{waits: true} = output), do: output
  defp finish(%{future: future} = output) when future != @nothing, do: output
  defp finish(%{pending: [_ | _]} = output), do: flush(output)

  defp finish(%{subs: subs} = output) do
    {done, waiting} = Enum.split_with(subs, &(&1.size == 0))
    Enum.each(done, &Subscriber.send_close(&1, output.closing))
    %{output | subs: waiting, closed: waiting == []}
  end

  defp less(:infinity, _n), do: :infinity
  defp less(room, n), do: room - n

  @doc "Returns the originating time of a held item."
  @spec time_of(held()) :: Situ.Time.t()
  def time_of({time, _data}), do: time
  def time_of(%Message{originating_time: time}), do: time
end
