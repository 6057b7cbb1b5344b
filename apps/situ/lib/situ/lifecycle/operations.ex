defmodule Situ.Lifecycle.Operations do
  @moduledoc false
  # The log of the operations that change a running pipeline: extend, remove, replace, tap and so on. Pure.
  #
  #   waiting -> running -> applied or refused
  #
  # An operation reads and writes keys: ids of stages, `{:path, path}`, `:graph` (all of it), `:clock`. Two operations
  # conflict if either writes a key that the other reads or writes. An operation waits for earlier operations with
  # which it conflicts; all others run concurrently. The server performs it, whole or not at all, and the caller
  # receives the reply.
  # See docs/adr/0165-changes-are-operations-in-one-log.md.
  alias Situ.Error
  alias Situ.Lifecycle.{Errors, State}

  # So many operations that have ended are kept for diagnostics.
  @kept 100

  defstruct last: 0, open: %{}, waiting: [], keys: %{}, ended: []

  @typedoc "The kind of change, its subject, and the keys that it reads and writes."
  @type scope :: %{what: {atom(), String.t() | nil}, reads: [term()], writes: [term()]}
  @type id :: pos_integer() | {:unit, String.t()}
  @type operation :: %{
          id: id(),
          what: {atom(), String.t() | nil},
          reads: [term()],
          writes: [term()],
          waits_for: MapSet.t(id()),
          request: term(),
          from: GenServer.from() | nil,
          by: pid() | nil,
          state: :waiting | :running | :applied | {:refused, Error.t()},
          accepted: Situ.Time.t(),
          ended: Situ.Time.t() | nil
        }
  @typedoc """
  `open` holds the operations that wait or run, `waiting` the ids of the former in order, `keys` which of them touch a
  key, and `ended` the last others, the newest first.
  """
  @type t :: %__MODULE__{
          last: non_neg_integer(),
          open: %{id() => operation()},
          waiting: [id()],
          keys: %{term() => %{id() => :read | :write}},
          ended: [operation()]
        }

  @doc "Adds an operation to the log; it starts now if it conflicts with no earlier one."
  @spec accept(State.t(), term(), scope(), GenServer.from() | nil, Situ.Time.t()) :: State.t()
  def accept(%{operations: %{last: last} = log} = state, request, scope, from, now) do
    operation = new(log, last + 1, scope, from, now)
    state = put_open(state, %{operation | request: request})
    log = %{state.operations | last: last + 1, waiting: log.waiting ++ [last + 1]}
    start_free(%{state | operations: log})
  end

  @doc "Adds a change that the life cycle has begun by itself; later operations wait for it."
  @spec add_running(State.t(), id(), scope(), Situ.Time.t()) :: State.t()
  def add_running(state, id, scope, now),
    do: put_open(state, %{new(state.operations, id, scope, nil, now) | state: :running})

  defp new(log, id, scope, from, now) do
    by = with {pid, _tag} <- from, do: pid
    times = %{accepted: now, ended: nil}
    operation = %{id: id, request: nil, from: from, by: by, state: :waiting}
    operation |> Map.merge(times) |> Map.merge(scope) |> Map.put(:waits_for, blockers(log, scope))
  end

  defp blockers(log, scope) do
    writers = for key <- scope.reads, {id, :write} <- Map.get(log.keys, key, %{}), do: id
    others = for key <- scope.writes, {id, _how} <- Map.get(log.keys, key, %{}), do: id
    MapSet.new(writers ++ others)
  end

  defp put_open(%{operations: log} = state, operation) do
    uses = Enum.map(operation.reads, &{&1, :read}) ++ Enum.map(operation.writes, &{&1, :write})

    keys =
      Enum.reduce(uses, log.keys, fn {key, how}, keys ->
        Map.update(keys, key, %{operation.id => how}, &Map.put(&1, operation.id, how))
      end)

    open = Map.put(log.open, operation.id, operation)
    %{state | operations: %{log | open: open, keys: keys}}
  end

  defp delete_open(log, operation) do
    keys =
      Enum.reduce(operation.reads ++ operation.writes, log.keys, fn key, keys ->
        left = keys |> Map.get(key, %{}) |> Map.delete(operation.id)
        if left == %{}, do: Map.delete(keys, key), else: Map.put(keys, key, left)
      end)

    %{log | open: Map.delete(log.open, operation.id), keys: keys}
  end

  @doc "Ends an operation with the reply for its caller, and starts the operations that waited for it."
  @spec finish(State.t(), id(), term(), Situ.Time.t()) :: State.t()
  def finish(%{operations: log} = state, id, answer, now) do
    case log.open do
      %{^id => operation} ->
        result = with {:error, error} <- answer, do: {:refused, error}, else: (_ -> :applied)
        ended = %{operation | state: result, from: nil, request: nil, ended: now}
        log = delete_open(log, operation)
        log = %{log | waiting: log.waiting -- [id], ended: Enum.take([ended | log.ended], @kept)}
        %{state | operations: log} |> reply(operation, answer) |> start_free()

      _ ->
        state
    end
  end

  @doc "Replies to the caller of an operation that continues, and that now writes only the keys `writes`."
  @spec answer(State.t(), id(), term(), [term()]) :: State.t()
  def answer(%{operations: log} = state, id, answer, writes) do
    case log.open do
      %{^id => operation} ->
        %{state | operations: delete_open(log, operation)}
        |> put_open(%{operation | from: nil, reads: [], writes: writes})
        |> reply(operation, answer)
        |> start_free()

      _ ->
        state
    end
  end

  @doc "Handles a caller's timeout: an operation that waits is refused; another one continues without its caller."
  @spec expire(State.t(), id(), Error.t(), Situ.Time.t()) :: State.t()
  def expire(%{operations: %{open: open} = log} = state, id, error, now) do
    case open do
      %{^id => %{state: :waiting}} ->
        finish(state, id, {:error, error}, now)

      # A checkpoint that has begun has its own deadline.
      %{^id => %{what: {kind, _subject}} = operation} when kind != :checkpoint ->
        open = %{open | id => %{operation | from: nil}}
        reply(%{state | operations: %{log | open: open}}, operation, {:error, error})

      _ ->
        state
    end
  end

  @doc "Refuses the operations that wait, because the pipeline is ending."
  @spec refuse_waiting(State.t(), Situ.Time.t()) :: State.t()
  def refuse_waiting(%{operations: %{waiting: waiting} = log} = state, now) do
    # None of them may start when an earlier one is refused.
    state = %{state | operations: %{log | waiting: []}}
    Enum.reduce(waiting, state, &finish(&2, &1, {:error, Errors.not_running()}, now))
  end

  defp reply(state, %{from: nil}, _answer), do: state
  defp reply(state, %{from: from}, answer), do: State.add_action(state, {:reply, from, answer})

  defp start_free(%{operations: %{waiting: waiting} = log} = state) do
    case Enum.split_with(waiting, &can_start?(log, log.open[&1])) do
      {[], _waiting} ->
        state

      {free, waiting} ->
        Enum.reduce(free, %{state | operations: %{log | waiting: waiting}}, &start(&2, &1))
    end
  end

  # An operation that still runs may have stopped touching a key.
  defp can_start?(log, operation) do
    not Enum.any?(operation.waits_for, fn id ->
      case log.open do
        %{^id => earlier} -> conflict?(earlier, operation)
        _ -> false
      end
    end)
  end

  defp conflict?(a, b) do
    Enum.any?(a.writes, &(&1 in b.writes or &1 in b.reads)) or
      Enum.any?(b.writes, &(&1 in a.reads))
  end

  defp start(%{operations: log} = state, id) do
    operation = %{log.open[id] | state: :running}
    state = %{state | operations: %{log | open: %{log.open | id => operation}}}
    State.add_action(state, {:perform, id, operation.request, operation.from})
  end

  @doc "Returns the operations of the log, the newest first."
  @spec list(t()) :: [operation()]
  def list(%__MODULE__{open: open, ended: ended}),
    do: (Map.values(open) ++ ended) |> Enum.sort_by(&{&1.accepted, &1.id}, :desc)
end
