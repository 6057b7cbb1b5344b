defmodule Situ.Stage.Outlet do
  @moduledoc false
  # One output of a running component: posting rules, the queue of messages whose time has not come, and one demand and
  # buffer per subscriber. Only `flush/1` and `close/2` send.
  alias Situ.{Error, Message}
  alias Situ.Stage.Counters

  defstruct [
    :name,
    :path,
    :source_id,
    :last_time,
    seq: 0,
    last_creation: nil,
    pending: [],
    pending_n: 0,
    future: [],
    future_rear: [],
    closing: nil,
    closed: false,
    subs: []
  ]

  @type sub :: %{
          tag: term(),
          pid: pid(),
          demand: integer() | :infinity,
          buffer: [[Message.t()]],
          rear: [[Message.t()]],
          size: non_neg_integer(),
          counters: Counters.t() | nil,
          waiting: boolean()
        }
  @type t :: %__MODULE__{}

  @doc "A subscriber without demand."
  @spec sub(term(), pid(), Counters.t() | nil) :: sub()
  def sub(tag, pid, counters) do
    %{
      tag: tag,
      pid: pid,
      demand: 0,
      buffer: [],
      rear: [],
      size: 0,
      counters: counters,
      waiting: false
    }
  end

  @doc "Posts data at `time`; held back until the clock reaches it when `enforce`d."
  @spec emit(t(), Situ.Time.t(), term(), Situ.Time.t(), boolean()) ::
          {:ok, t()} | {:error, Error.t()}
  def emit(%__MODULE__{closing: closing} = outlet, _time, _data, _now, _enforce)
      when closing != nil,
      do: {:ok, outlet}

  def emit(%__MODULE__{last_time: last} = outlet, time, _data, _now, _enforce)
      when is_integer(last) and time <= last,
      do: {:error, not_increasing(outlet, time)}

  def emit(%__MODULE__{future: []} = outlet, time, data, now, enforce)
      when not enforce or time <= now,
      do: {:ok, post(%{outlet | last_time: time}, time, data, now)}

  def emit(%__MODULE__{} = outlet, time, data, _now, _enforce),
    do: {:ok, hold(%{outlet | last_time: time}, {time, data})}

  @doc """
  Posts the leading `{name, time, data}` actions that are for this output, in one go; answers the actions left over.
  """
  @spec emit_all(t(), [tuple()], Situ.Time.t(), boolean(), integer() | nil) ::
          {:ok, t(), [tuple()]} | {:error, Error.t()}
  def emit_all(%__MODULE__{closing: nil, future: []} = outlet, actions, now, false, nil) do
    creation = if outlet.last_creation == nil, do: now, else: max(now, outlet.last_creation)
    first = outlet.last_time || :none
    start = {outlet.name, creation, outlet.source_id}

    case post_all(actions, start, first, outlet.seq, outlet.pending) do
      {:stuck, time, last} ->
        {:error, not_increasing(%{outlet | last_time: last}, time)}

      {rest, last, seq, pending} ->
        last = if last == :none, do: nil, else: last
        n = outlet.pending_n + seq - outlet.seq

        {:ok,
         %{
           outlet
           | last_time: last,
             last_creation: creation,
             seq: seq,
             pending: pending,
             pending_n: n
         }, rest}
    end
  end

  def emit_all(outlet, [{_, time, _} | rest], _now, _enforce, final)
      when is_integer(final) and time > final,
      do: {:ok, outlet, rest}

  def emit_all(outlet, [{_, time, data} | rest], now, enforce, _final) do
    with {:ok, outlet} <- emit(outlet, time, data, now, enforce), do: {:ok, outlet, rest}
  end

  defp post_all([{name, time, data} | rest], {name, creation, id} = start, last, seq, pending)
       when is_integer(time) do
    if time > last or last == :none do
      seq = seq + 1

      message = %Message{
        data: data,
        originating_time: time,
        creation_time: creation,
        sequence_id: seq,
        source_id: id
      }

      post_all(rest, start, time, seq, [message | pending])
    else
      {:stuck, time, last}
    end
  end

  defp post_all(rest, _start, last, seq, pending), do: {rest, last, seq, pending}

  @doc "Posts a message with its own envelope; only the source id becomes this output's."
  @spec forward(t(), Message.t(), Situ.Time.t(), boolean()) :: {:ok, t()} | {:error, Error.t()}
  def forward(%__MODULE__{closing: closing} = outlet, _message, _now, _enforce)
      when closing != nil,
      do: {:ok, outlet}

  def forward(%__MODULE__{} = outlet, %Message{} = message, now, enforce) do
    case check(outlet, message) do
      :ok when (not enforce or message.originating_time <= now) and outlet.future == [] ->
        {:ok, push(remember(outlet, message), message)}

      :ok ->
        {:ok, hold(remember(outlet, message), message)}

      error ->
        error
    end
  end

  @doc """
  Forwards the leading `{name, message}` actions that are for this output, in one go; answers the actions left over.
  """
  @spec forward_all(t(), [tuple()], Situ.Time.t(), boolean()) ::
          {:ok, t(), [tuple()]} | {:error, Error.t()}
  def forward_all(
        %__MODULE__{closing: nil, future: [], last_time: last} = outlet,
        [_, _ | _] = actions,
        _now,
        false
      )
      when is_integer(last) do
    case push_all(
           actions,
           outlet.name,
           outlet.source_id,
           last,
           outlet.seq,
           outlet.last_creation,
           nil,
           outlet.pending,
           0
         ) do
      # The first does not fit: `forward/4` says why.
      {rest, 0, _last, _pending} ->
        forward_one(outlet, rest, 0, false)

      {rest, n, message, pending} ->
        outlet = remember(outlet, message)
        {:ok, %{outlet | pending: pending, pending_n: outlet.pending_n + n}, rest}
    end
  end

  def forward_all(outlet, actions, now, enforce), do: forward_one(outlet, actions, now, enforce)

  defp forward_one(outlet, [{_, message} | rest], now, enforce) do
    with {:ok, outlet} <- forward(outlet, message, now, enforce), do: {:ok, outlet, rest}
  end

  defp push_all(
         [{name, %Message{originating_time: time, sequence_id: id} = message} | rest],
         name,
         source,
         last,
         seq,
         made,
         _previous,
         pending,
         n
       )
       when time > last and id > seq and message.creation_time >= made do
    pending = [%{message | source_id: source} | pending]
    push_all(rest, name, source, time, id, message.creation_time, message, pending, n + 1)
  end

  defp push_all(rest, _name, _source, _last, _seq, _made, message, pending, n),
    do: {rest, n, message, pending}

  @doc "Releases held messages whose time has come."
  @spec release(t(), Situ.Time.t()) :: t()
  def release(%__MODULE__{future: []} = outlet, _now), do: outlet

  def release(%__MODULE__{future: [first | rest]} = outlet, now) do
    if time_of(first) <= now do
      outlet = if rest == [], do: turn(outlet), else: %{outlet | future: rest}
      outlet |> let_go(first, now) |> release(now)
    else
      outlet
    end
  end

  @doc "The time of the next held message, or `nil`."
  @spec next_time(t()) :: Situ.Time.t() | nil
  def next_time(%__MODULE__{future: []}), do: nil
  def next_time(%__MODULE__{future: [first | _]}), do: time_of(first)

  @doc "Throws away held messages later than `final`."
  @spec cut(t(), Situ.Time.t()) :: t()
  def cut(%__MODULE__{future: []} = outlet, _final), do: outlet

  def cut(%__MODULE__{} = outlet, final) do
    kept = Enum.filter(outlet.future ++ Enum.reverse(outlet.future_rear), &(time_of(&1) <= final))
    %{outlet | future: kept, future_rear: []}
  end

  @doc "How many messages may be posted now: the least demand of its subscribers, less what waits in buffers."
  @spec room(t()) :: integer() | :infinity
  def room(%__MODULE__{subs: []}), do: :infinity
  def room(%__MODULE__{closed: true}), do: :infinity
  def room(%__MODULE__{subs: [sub], pending_n: n}), do: less(free(sub), n)

  def room(%__MODULE__{subs: subs, pending_n: n}),
    do: subs |> Enum.map(&free/1) |> Enum.min() |> less(n)

  @doc "Adds a batch already made (chains), oldest last."
  @spec push_reversed(t(), [Message.t()], non_neg_integer()) :: t()
  def push_reversed(%__MODULE__{pending: []} = outlet, reversed, n),
    do: %{outlet | pending: reversed, pending_n: n}

  def push_reversed(%__MODULE__{} = outlet, reversed, n),
    do: %{outlet | pending: reversed ++ outlet.pending, pending_n: outlet.pending_n + n}

  @doc "Hands pending messages to the subscribers, as far as their demand goes; sends closing marks that waited for it."
  @spec flush(t()) :: t()
  def flush(%__MODULE__{pending: [], closing: nil} = outlet), do: outlet
  def flush(%__MODULE__{pending: []} = outlet), do: finish(outlet)
  def flush(%__MODULE__{subs: []} = outlet), do: finish(%{outlet | pending: [], pending_n: 0})

  def flush(%__MODULE__{pending_n: n} = outlet) do
    messages = :lists.reverse(outlet.pending)
    subs = Enum.map(outlet.subs, &give(&1, messages, n))
    finish(%{outlet | pending: [], pending_n: 0, subs: subs})
  end

  @doc "More demand from one subscriber."
  @spec ask(t(), term(), pos_integer() | :infinity) :: t()
  def ask(%__MODULE__{} = outlet, tag, n) do
    subs =
      Enum.map(outlet.subs, fn
        %{tag: ^tag} = sub -> drain(%{sub | demand: more(sub.demand, n)})
        sub -> sub
      end)

    finish(%{outlet | subs: subs})
  end

  @doc "Nothing more will come; the closing mark goes out after everything before it."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{closing: nil} = outlet, time),
    do: flush(cut(%{outlet | closing: time}, time))

  def close(%__MODULE__{} = outlet, _time), do: outlet

  @doc "Adds a subscriber to a running output; a closed one answers with the closing mark."
  @spec subscribe(t(), sub()) :: t()
  def subscribe(%__MODULE__{closed: true} = outlet, sub) do
    send_close(sub, outlet.closing)
    outlet
  end

  def subscribe(%__MODULE__{} = outlet, sub), do: %{outlet | subs: outlet.subs ++ [sub]}

  @doc "Takes a subscriber away, with what waited for it."
  @spec cancel(t(), (sub() -> boolean())) :: t()
  def cancel(%__MODULE__{} = outlet, which?) do
    finish(%{outlet | subs: Enum.reject(outlet.subs, which?)})
  end

  defp finish(%{closing: nil} = outlet), do: outlet
  defp finish(%{closed: true} = outlet), do: outlet
  defp finish(%{future: [_ | _]} = outlet), do: outlet
  defp finish(%{pending: [_ | _]} = outlet), do: flush(outlet)

  defp finish(%{subs: subs} = outlet) do
    {done, waiting} = Enum.split_with(subs, &(&1.size == 0))
    Enum.each(done, &send_close(&1, outlet.closing))
    %{outlet | subs: waiting, closed: waiting == []}
  end

  defp send_close(sub, time),
    do:
      send(
        sub.pid,
        {:"$gen_consumer", {self(), sub.tag}, {:cancel, {:shutdown, {:closed, time}}}}
      )

  defp give(%{size: 0, demand: demand} = sub, messages, n)
       when demand == :infinity or demand >= n do
    count(sub, n)
    send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, messages})
    %{sub | demand: minus(demand, n)}
  end

  defp give(sub, messages, n) do
    count(sub, n)
    drain(%{sub | rear: [messages | sub.rear], size: sub.size + n})
  end

  defp drain(%{size: 0} = sub), do: note_waiting(sub, false)
  defp drain(%{demand: 0} = sub), do: note_waiting(sub, true)

  defp drain(%{buffer: [], rear: rear} = sub),
    do: drain(%{sub | buffer: Enum.reverse(rear), rear: []})

  defp drain(%{buffer: [batch | rest], demand: demand} = sub) do
    {now, later} = split(batch, demand)
    n = length(now)
    send(sub.pid, {:"$gen_consumer", {self(), sub.tag}, now})
    buffer = if later == [], do: rest, else: [later | rest]
    drain(%{sub | buffer: buffer, size: sub.size - n, demand: minus(demand, n)})
  end

  defp split(batch, :infinity), do: {batch, []}
  defp split(batch, n), do: Enum.split(batch, n)

  defp note_waiting(%{waiting: same} = sub, same), do: sub
  defp note_waiting(%{counters: nil} = sub, _flag), do: sub

  defp note_waiting(sub, flag) do
    Counters.waiting(sub.counters, if(flag, do: 1, else: 0))
    %{sub | waiting: flag}
  end

  defp count(%{counters: nil}, _n), do: :ok
  defp count(%{counters: counters}, n), do: Counters.emitted(counters, n)

  defp free(%{demand: :infinity}), do: :infinity
  defp free(%{size: 0, demand: demand}), do: demand
  defp free(%{size: size}), do: -size

  defp less(:infinity, _n), do: :infinity
  defp less(room, n), do: room - n
  defp minus(:infinity, _n), do: :infinity
  defp minus(demand, n), do: demand - n
  defp more(:infinity, _n), do: :infinity
  defp more(_demand, :infinity), do: :infinity
  defp more(demand, n), do: demand + n

  defp post(outlet, time, data, now) do
    creation = if outlet.last_creation == nil, do: now, else: max(now, outlet.last_creation)
    seq = outlet.seq + 1

    message = %Message{
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: seq,
      source_id: outlet.source_id
    }

    %{
      outlet
      | seq: seq,
        last_creation: creation,
        pending: [message | outlet.pending],
        pending_n: outlet.pending_n + 1
    }
  end

  defp push(outlet, message) do
    message = %{message | source_id: outlet.source_id}
    %{outlet | pending: [message | outlet.pending], pending_n: outlet.pending_n + 1}
  end

  defp remember(outlet, message) do
    %{
      outlet
      | last_time: message.originating_time,
        last_creation: message.creation_time,
        seq: message.sequence_id
    }
  end

  defp hold(%{future: []} = outlet, item), do: %{outlet | future: [item]}
  defp hold(outlet, item), do: %{outlet | future_rear: [item | outlet.future_rear]}

  defp turn(outlet), do: %{outlet | future: Enum.reverse(outlet.future_rear), future_rear: []}

  defp let_go(outlet, {time, data}, now), do: post(outlet, time, data, now)
  defp let_go(outlet, %Message{} = message, _now), do: push(outlet, message)

  defp time_of({time, _data}), do: time
  defp time_of(%Message{originating_time: time}), do: time

  defp check(%{last_time: nil}, _message), do: :ok

  defp check(outlet, message) do
    cond do
      message.sequence_id <= outlet.seq ->
        {:error, bad_sequence(outlet, message.sequence_id)}

      message.originating_time <= outlet.last_time ->
        {:error, not_increasing(outlet, message.originating_time)}

      message.creation_time < outlet.last_creation ->
        {:error, bad_creation(outlet, message.creation_time)}

      true ->
        :ok
    end
  end

  defp not_increasing(outlet, time) do
    Error.new(
      :time_not_increasing,
      "#{outlet.path}.#{outlet.name} emitted at #{time} ns after #{outlet.last_time} ns",
      why: "originating times of one output strictly increase",
      fix: "give each message its own, later time; in a cycle, delay the message",
      meta: %{
        component: outlet.path,
        output: outlet.name,
        time: time,
        last_time: outlet.last_time
      }
    )
  end

  defp bad_sequence(outlet, id) do
    Error.new(
      :sequence_not_increasing,
      "#{outlet.path}.#{outlet.name} emitted sequence id #{id} after #{outlet.seq}",
      why: "sequence ids of one output strictly increase",
      meta: %{component: outlet.path, output: outlet.name, sequence_id: id, last: outlet.seq}
    )
  end

  defp bad_creation(outlet, time) do
    Error.new(
      :creation_time_went_back,
      "#{outlet.path}.#{outlet.name} emitted a message created at #{time} ns after one created at #{outlet.last_creation} ns",
      why: "creation times of one output never decrease",
      meta: %{
        component: outlet.path,
        output: outlet.name,
        time: time,
        last_time: outlet.last_creation
      }
    )
  end
end
