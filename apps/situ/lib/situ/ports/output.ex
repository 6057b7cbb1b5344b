defmodule Situ.Ports.Output do
  @moduledoc false
  # One output of a running component: posted messages (see PostingRules), messages that wait for their time, and its
  # subscribers. Only `flush/2`, `add_demand/3`, `refresh_subscriber/2` and `close/2` send messages.
  alias Situ.Columns.Validation
  alias Situ.Delivery.Batch
  alias Situ.Message
  alias Situ.Ports.Subscriber

  @compile {:inline, subtract: 2, record_posted: 2, record_sent: 1, finish: 1}

  @nothing {[], []}

  @enforce_keys [:port]
  defstruct [
    :port,
    :last_time,
    :last_creation,
    :wanted,
    :resume,
    :ending,
    seq: 0,
    repeated: 0,
    pending: [],
    pending_n: 0,
    future: @nothing,
    subs: []
  ]

  @typedoc "An item that waits for its time: data with its time, or a message with its own envelope."
  @type held :: {Situ.Time.t(), term()} | Message.t()
  @typedoc """
  The constant part: name, the component's path, the stream's id, the rule for equal times, and where the progress is
  recorded for a process that replaces a dead one.
  """
  @type port_of :: %{
          name: atom(),
          path: String.t(),
          source_id: non_neg_integer(),
          same_time: :error | :drop | :nudge,
          mark: {marks(), non_neg_integer()} | nil
        }
  @typedoc """
  A batch, or messages that are still being added: times and data (reversed) of one creation time, or messages with
  their own envelopes (reversed).
  """
  @type part ::
          Batch.t()
          | {:open, created :: Situ.Time.t(), first_id :: non_neg_integer(),
             base :: Situ.Time.t(), times :: [integer()], data :: [term()], pos_integer()}
          | {:own, [Message.t()]}

  @typedoc """
  `last_time`, `last_creation` and `seq` belong to the last message posted. `pending` is sent with the next flush,
  newest first; `future` (front and reversed rear) waits for the clock. `ending` holds the closing time: `:withheld`
  until the pipeline knows that the source ends, `:closed` once all subscribers know it. Messages up to `resume` were
  posted before a restart; `repeated` counts them. `wanted` is for nudged times (see PostingRules).
  """
  @type t :: %__MODULE__{
          port: port_of(),
          last_time: Situ.Time.t() | nil,
          last_creation: Situ.Time.t() | nil,
          wanted: {Situ.Time.t(), Situ.Time.t()} | nil,
          resume: Situ.Time.t() | nil,
          ending: nil | {:withheld | :closing | :closed, Situ.Time.t() | nil},
          seq: non_neg_integer(),
          repeated: non_neg_integer(),
          pending: [part()],
          pending_n: non_neg_integer(),
          future: {[held()], [held()]},
          subs: [Subscriber.t()]
        }
  @type marks :: :atomics.atomics_ref()

  @doc "Builds an output without subscribers."
  @spec new(atom(), String.t(), non_neg_integer(), :error | :drop | :nudge) :: t()
  def new(name, path, source_id, same_time \\ :error) do
    port = %{name: name, path: path, source_id: source_id, same_time: same_time, mark: nil}
    %__MODULE__{port: port}
  end

  @doc """
  Creates shared memory for the progress of this many outputs, so that a process that replaces a dead one continues from
  there.
  """
  @spec new_marks(non_neg_integer()) :: marks()
  def new_marks(outputs), do: :atomics.new(max(outputs, 1) * 6, signed: true)

  @doc "Attaches the output to its entry in `marks`; it continues from the previous progress and records its own."
  @spec attach_marks(t(), marks() | nil, non_neg_integer()) :: t()
  def attach_marks(output, nil, _index), do: output

  def attach_marks(%__MODULE__{port: port} = output, marks, index) do
    output = %{output | port: %{port | mark: {marks, index * 6}}}
    # Messages that the previous process had posted, but not sent, are posted again.
    for i <- 1..3, do: :atomics.put(marks, index * 6 + i + 3, :atomics.get(marks, index * 6 + i))

    case :atomics.get(marks, index * 6 + 3) do
      0 ->
        output

      seq ->
        time = :atomics.get(marks, index * 6 + 1)
        creation = :atomics.get(marks, index * 6 + 2)
        resume_after_restart(%{output | last_time: time, last_creation: creation, seq: seq})
    end
  end

  @doc "Neither records the progress nor continues from it."
  @spec forget_marks(t()) :: t()
  def forget_marks(%__MODULE__{port: port} = output), do: %{output | port: %{port | mark: nil}}

  # Words 4 to 6 are the stamp of the last posted message, words 1 to 3 the stamp of the last message that was sent to
  # every subscriber. A process that replaces this one posts the messages again that were still waiting for demand.
  defp record_posted(%{mark: nil}, _stamp), do: :ok

  defp record_posted(%{mark: {marks, base}}, {time, creation, id}) do
    :atomics.put(marks, base + 4, time)
    :atomics.put(marks, base + 5, creation)
    :atomics.put(marks, base + 6, id)
  end

  defp record_sent(%{port: %{mark: nil}} = output), do: output

  defp record_sent(output) do
    # Messages for a local subscriber still have to pass through another step of the stage.
    if Enum.any?(output.subs, &(&1.demand == :local)),
      do: output,
      else: record_progress(output)
  end

  @doc """
  Records that a process that replaces this one continues after the last posted message, if nothing waits for the demand
  of a subscriber. Everything that another step of the stage makes of the messages must have been sent.
  """
  @spec record_progress(t()) :: t()
  def record_progress(%__MODULE__{port: %{mark: nil}} = output), do: output

  def record_progress(%__MODULE__{port: %{mark: {marks, base}}} = output) do
    if all_sent?(output),
      do: for(i <- 1..3, do: :atomics.put(marks, base + i, :atomics.get(marks, base + i + 3)))

    output
  end

  @doc "Returns whether no message waits for the demand of a subscriber that must receive all."
  @spec all_sent?(t()) :: boolean()
  def all_sent?(%__MODULE__{pending: pending, subs: subs}),
    do: pending == [] and Enum.all?(subs, &(&1.size == 0 or &1.queue != nil))

  @doc "Marks messages up to the last time as already posted, because the component restarts."
  @spec resume_after_restart(t()) :: t()
  def resume_after_restart(%__MODULE__{} = output), do: %{output | resume: output.last_time}

  @doc "Returns whether messages wait for their time."
  @spec messages_held?(t()) :: boolean()
  def messages_held?(%__MODULE__{future: future}), do: future != @nothing

  @doc "Returns the time of the next held message, or `nil`."
  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{future: {[], _}}), do: nil
  def next_time(%__MODULE__{future: {[first | _], _}}), do: held_time(first)

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
    future = if front == [], do: {:lists.reverse(rear), []}, else: {front, rear}
    if held_time(first) <= now, do: {first, %{output | future: future}}
  end

  @doc "Discards held messages later than `final`, or all with `:none`."
  @spec drop_held_after(t(), Situ.Time.t() | :none) :: t()
  def drop_held_after(%__MODULE__{future: @nothing} = output, _final), do: output
  def drop_held_after(%__MODULE__{} = output, :none), do: %{output | future: @nothing}

  def drop_held_after(%__MODULE__{future: {front, rear}} = output, final) do
    kept = Enum.filter(front ++ Enum.reverse(rear), &(held_time(&1) <= final))
    %{output | future: {kept, []}}
  end

  defp held_time({time, _data}), do: time
  defp held_time(%Message{originating_time: time}), do: time

  @doc "Returns how many messages may be posted: the smallest demand of its subscribers minus pending messages."
  @spec available_room(t()) :: integer() | :infinity
  def available_room(%__MODULE__{subs: []}), do: :infinity
  def available_room(%__MODULE__{ending: {:closed, _}}), do: :infinity

  def available_room(%__MODULE__{subs: [sub], pending_n: n}),
    do: subtract(Subscriber.free_capacity(sub), n)

  def available_room(%__MODULE__{subs: subs, pending_n: n}),
    do: subs |> least_capacity(:infinity) |> subtract(n)

  # Below one there is no room, however little the others have.
  defp least_capacity(_subs, least) when least < 1, do: least
  defp least_capacity([], least), do: least

  defp least_capacity([sub | rest], least),
    do: least_capacity(rest, min(Subscriber.free_capacity(sub), least))

  defp subtract(:infinity, _n), do: :infinity
  defp subtract(room, n), do: room - n

  @doc "Returns the creation time of a message that is posted at `now`: creation times never go backwards."
  @spec creation_time(t(), Situ.Time.t()) :: Situ.Time.t()
  def creation_time(%__MODULE__{last_creation: nil}, now), do: now
  def creation_time(%__MODULE__{last_creation: last}, now), do: max(now, last)

  @doc """
  Posts the results of operators at clock time `now`: data with times relative to `base`. `last` is the time of the last
  message that they have handled.
  """
  @spec post_results(t(), Situ.Time.t(), {Situ.Time.t(), [integer()], [term()]}, Situ.Time.t()) ::
          t()
  # Messages up to `resume` were posted before a restart.
  def post_results(%__MODULE__{resume: until} = output, last, {base, times, data}, now)
      when until != nil do
    case Enum.split_while(times, &(base + &1 <= until)) do
      {repeated, []} ->
        %{output | repeated: output.repeated + length(repeated)}

      {repeated, times} ->
        n = length(repeated)
        output = %{output | resume: nil, repeated: output.repeated + n}
        post_results(output, last, {base, times, Enum.drop(data, n)}, now)
    end
  end

  def post_results(%__MODULE__{} = output, last, {_base, [], []}, _now),
    do: %{output | last_time: last}

  def post_results(%__MODULE__{seq: seq} = output, last, {base, times, data}, now) do
    n = length(data)
    created = creation_time(output, now)
    output = %{output | seq: seq + n, last_creation: created, last_time: last}

    if output.subs == [] do
      output
    else
      batch = %Batch{
        source_id: output.port.source_id,
        created: created,
        first_id: seq + 1,
        last_time: last,
        base: base,
        times: times,
        data: data,
        size: n
      }

      %{output | pending: [batch | output.pending], pending_n: output.pending_n + n}
    end
  end

  @doc "Posts columns that have their envelopes."
  @spec post_columns(t(), Situ.Columns.t()) :: t()
  def post_columns(%__MODULE__{} = output, columns) do
    {last, created, id} = Batch.last_stamp(columns)
    output = %{output | seq: id, last_creation: created, last_time: last}

    if output.subs == [] do
      output
    else
      batch = Validation.mark_checked(%{columns | source_id: output.port.source_id})
      %{output | pending: [batch | output.pending], pending_n: output.pending_n + columns.count}
    end
  end

  @doc "Delivers pending messages at clock time `now` to the subscribers within their demand, and the closing mark."
  @spec flush(t(), Situ.Time.t()) :: t()
  def flush(%__MODULE__{ending: {:withheld, _time}} = output, _now), do: output
  def flush(%__MODULE__{pending: []} = output, _now), do: finish(output)

  def flush(%__MODULE__{pending_n: n} = output, now) do
    batches = close_parts(output.pending, output.port.source_id, [])
    {time, creation, _id} = stamp = Batch.last_stamp(:lists.last(batches))
    record_posted(output.port, stamp)
    latency = {time, creation - time}
    subs = for sub <- output.subs, do: Subscriber.deliver_batches(sub, batches, n, latency, now)
    finish(%{output | pending: [], pending_n: 0, subs: subs})
  end

  defp close_parts([], _source_id, batches), do: batches

  defp close_parts([{:open, created, id, base, times, data, n} | rest], source_id, batches) do
    batch = %Batch{
      source_id: source_id,
      created: created,
      first_id: id,
      last_time: base + hd(times),
      base: base,
      times: :lists.reverse(times),
      data: :lists.reverse(data),
      size: n
    }

    close_parts(rest, source_id, [batch | batches])
  end

  defp close_parts([{:own, messages} | rest], source_id, batches),
    do: close_parts(rest, source_id, [:lists.reverse(messages) | batches])

  defp close_parts([batch | rest], source_id, batches),
    do: close_parts(rest, source_id, [batch | batches])

  @doc "Returns the messages that the next flush will deliver."
  @spec list_pending(t()) :: [Message.t()]
  def list_pending(%__MODULE__{ending: {:withheld, _time}}), do: []

  def list_pending(%__MODULE__{pending: pending, port: port}),
    do: pending |> close_parts(port.source_id, []) |> Enum.flat_map(&Batch.messages/1)

  @doc "Takes the batches that wait for other steps of the stage; their closing mark follows: `[{tag, batches}]`."
  @spec take_local(t()) :: {[{term(), [Batch.t()]}], t()}
  def take_local(%__MODULE__{subs: subs} = output) do
    case for %{demand: :local, rear: [_ | _]} = sub <- subs, do: sub do
      [] ->
        {[], output}

      waiting ->
        taken = for sub <- waiting, do: {sub.tag, elem(Subscriber.take_buffer(sub), 0)}

        emptied = fn sub ->
          if sub in waiting, do: elem(Subscriber.take_buffer(sub), 1), else: sub
        end

        {taken, finish(%{output | subs: Enum.map(subs, emptied)})}
    end
  end

  @doc "Adds demand of the subscriber with this pid and tag. Returns `:error` for an unknown subscriber."
  @spec add_demand(t(), {pid(), term()}, pos_integer() | :infinity) :: {:ok, t()} | :error
  def add_demand(%__MODULE__{subs: [%{pid: pid, tag: tag} = sub]} = output, {pid, tag}, n),
    do: {:ok, finish(%{output | subs: [Subscriber.add_demand(sub, n)]})}

  def add_demand(%__MODULE__{} = output, from, n),
    do: update_subscriber(output, from, &Subscriber.add_demand(&1, n))

  @doc "Sends a subscriber with a lossy policy the newest messages immediately, whatever its demand."
  @spec refresh_subscriber(t(), {pid(), term()}) :: {:ok, t()} | :error
  def refresh_subscriber(%__MODULE__{} = output, from),
    do: update_subscriber(output, from, &Subscriber.deliver_newest/1)

  defp update_subscriber(%{subs: subs} = output, {pid, tag}, fun) do
    case Enum.split_while(subs, &(&1.tag != tag or &1.pid != pid)) do
      {_others, []} -> :error
      {before, [sub | rest]} -> {:ok, finish(%{output | subs: before ++ [fun.(sub) | rest]})}
    end
  end

  @doc "Updates every subscriber with this tag."
  @spec map_tagged(t(), term(), (Subscriber.t() -> Subscriber.t())) :: t()
  def map_tagged(%__MODULE__{subs: subs} = output, tag, fun),
    do: %{output | subs: Enum.map(subs, &if(&1.tag == tag, do: fun.(&1), else: &1))}

  @doc "Closes the output; the next flush sends the closing mark after all messages before it."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{ending: ending} = output, time) when ending in [nil, {:withheld, nil}] do
    how = if ending == nil, do: :closing, else: :withheld
    output = drop_held_after(%{output | ending: {how, time}}, time)
    %{output | subs: Enum.map(output.subs, &Subscriber.drop_after(&1, time))}
  end

  def close(%__MODULE__{} = output, _time), do: output

  @doc "Sets whether pending messages and the closing mark are withheld for now."
  @spec set_withheld(t(), boolean()) :: t()
  def set_withheld(%__MODULE__{ending: nil} = output, true),
    do: %{output | ending: {:withheld, nil}}

  def set_withheld(%__MODULE__{ending: {:closing, time}} = output, true),
    do: %{output | ending: {:withheld, time}}

  def set_withheld(%__MODULE__{ending: {:withheld, time}} = output, false),
    do: %{output | ending: time && {:closing, time}}

  def set_withheld(%__MODULE__{} = output, _withheld?), do: output

  @doc "Returns the closing time, or `nil` while the output is open."
  @spec closing_time(t()) :: Situ.Time.t() | nil
  def closing_time(%__MODULE__{ending: nil}), do: nil
  def closing_time(%__MODULE__{ending: {_how, time}}), do: time

  @doc "Adds a subscriber to a running output; a closed output sends the closing mark instead."
  @spec subscribe(t(), Subscriber.t()) :: t()
  def subscribe(%__MODULE__{ending: {:closed, time}} = output, sub) do
    Subscriber.send_close(sub, time)
    output
  end

  def subscribe(%__MODULE__{} = output, sub), do: %{output | subs: output.subs ++ [sub]}

  @doc "Removes subscribers and the messages that wait for them."
  @spec cancel_subscribers(t(), (Subscriber.t() -> boolean())) :: t()
  def cancel_subscribers(%__MODULE__{} = output, which?),
    do: finish(%{output | subs: Enum.reject(output.subs, which?)})

  @doc "Sends the subscriber with this tag all its waiting messages, regardless of demand, and the closing mark."
  @spec cut_subscriber(t(), term(), Situ.Time.t()) :: t()
  def cut_subscriber(%__MODULE__{subs: subs} = output, tag, time) do
    cut = fn
      %{tag: ^tag} = sub ->
        sub |> Subscriber.add_demand(:infinity) |> Subscriber.close_drained(time)

      sub ->
        [sub]
    end

    finish(%{output | subs: Enum.flat_map(subs, cut)})
  end

  @doc "Returns whether every subscriber has received all its messages and the closing mark."
  @spec drained?(t()) :: boolean()
  def drained?(%__MODULE__{subs: subs}), do: Enum.all?(subs, &Subscriber.closed?/1)

  @doc "Returns how many messages wait for demand."
  @spec buffered_count(t()) :: non_neg_integer()
  def buffered_count(%__MODULE__{} = output),
    do: Enum.reduce(output.subs, output.pending_n, &max(&1.size, &2))

  defp finish(output), do: output |> record_sent() |> send_closing()

  # Sends the closing mark to the subscribers that have received all their messages.
  defp send_closing(%{ending: {:closing, time}, pending: [], future: @nothing} = output) do
    output = %{output | subs: Enum.flat_map(output.subs, &Subscriber.close_drained(&1, time))}
    if drained?(output), do: %{output | ending: {:closed, time}}, else: output
  end

  defp send_closing(output), do: output
end
