defmodule Situ.Stage.SharedProcess do
  @moduledoc false
  # The process of several light stages. Each of them has the same state and protocol as in a separate process (see
  # Situ.Stage). The messages between them wait in a local queue, so they are not copied and wake up no process.
  # See docs/adr/0012-light-stages-share-a-process.md.
  use GenServer
  require Logger
  require Situ.Stage.Pause

  alias Situ.Clock.Timers
  alias Situ.Ports.{Address, Input, Outputs}
  alias Situ.{Runtime, Stage}
  alias Situ.Stage.{Departure, Load, Loop, Pause, RequestHandler, State, Step, Subscriptions}

  @slice_ns 5_000_000

  defstruct members: %{},
            consumers: %{},
            producers: %{},
            paused: %{},
            leaving: %{},
            relays: %{},
            ready: [],
            sources: [],
            waiting: [],
            scheduled: false,
            saturated: 0

  @typedoc """
  `members` holds the stages by id; `consumers` and `producers` the stage of each connection to another process, as far
  as it was looked up. `paused` holds the stages that are paused for a checkpoint: the checkpoint's reference, whether a
  time slice was scheduled, the messages that arrived since, newest first, and the actions of changes. `leaving` holds
  the stages that leave or have left (see Departure): the messages that are kept for them, newest first, or their
  process; `relays` the addresses that their messages need.

  `ready` and `sources` hold the stages to run, newest first: sources run when nothing else has anything to do, so that
  messages do not pile up. `waiting` holds messages that were taken from the local queue but not handled when the last
  time slice ended, and `saturated` counts the time slices in a row after which there were some.
  """
  @type t :: %__MODULE__{
          members: %{pos_integer() => State.t()},
          consumers: %{term() => pos_integer()},
          producers: %{term() => pos_integer()},
          paused: %{pos_integer() => {term(), boolean(), [term()], [term()]}},
          leaving: %{pos_integer() => {:kept, [term()]} | {:moved, pid()}},
          relays: %{({:producer, term()} | {:consumer, term()}) => pid()},
          ready: [pos_integer()],
          sources: [pos_integer()],
          waiting: [{pos_integer(), term()}],
          scheduled: boolean(),
          saturated: non_neg_integer()
        }

  @doc "Starts the process with the arguments of each stage; every stage reports to the server by itself."
  @spec spawn_link([map(), ...]) :: pid()
  def spawn_link([%{vertices: [head | _]} | _] = stages) do
    opts = [:link, fullsweep_after: 30]
    Runtime.spawn_process(:proc_lib, head.path, {__MODULE__, :init_it, [stages]}, opts)
  end

  @doc false
  def init_it([%{server: server, pipeline: name} | _] = stages) do
    Process.flag(:trap_exit, true)
    Process.put(:situ_pipeline, server)
    Logger.metadata(pipeline: name)

    members =
      for args <- stages,
          {:ok, state} <- [Stage.start_component(Map.put(args, :shared?, true))],
          into: %{},
          do: {args.id, state}

    if members == %{},
      do: exit(:normal),
      else: Runtime.enter_loop(__MODULE__, %__MODULE__{members: members})
  end

  @impl true
  def init(_), do: :ignore

  @impl true
  def handle_info({:situ, {:to, id, request}}, process),
    do: run_stage(process, id, {:situ, request})

  def handle_info({:situ_relay, tag, request}, %{relays: relays} = process) do
    with %{{:producer, ^tag} => producer} <- relays,
         do: Address.relay_request(producer, tag, request)

    {:noreply, process}
  end

  def handle_info({:situ, {:relocated, id, pid}}, process),
    do: process |> Departure.finish(id, pid) |> end_slice()

  def handle_info({:situ, {:refresh, {_pid, tag}}} = message, process),
    do: run_producer(process, tag, message)

  def handle_info({:situ, {:untap, tag}} = entry, process), do: run_producer(process, tag, entry)

  def handle_info({:"$gen_consumer", {_pid, tag}, _entry} = message, process),
    do: run_consumer(process, tag, message)

  # The subscription names the stage (see `Situ.Pipeline.Dynamic.Tap.fetch_subscription/2`).
  def handle_info(
        {:"$gen_producer", {_pid, tag}, {:subscribe, _current, opts}} = message,
        process
      ) do
    with true <- Keyword.keyword?(opts), {:ok, id} <- Keyword.fetch(opts, :stage) do
      producers = Map.put_new(process.producers, tag, id)
      run_stage(%{process | producers: producers}, id, message)
    else
      _unknown -> run_producer(process, tag, message)
    end
  end

  def handle_info({:"$gen_producer", {_pid, tag}, _request} = message, process),
    do: run_producer(process, tag, message)

  def handle_info({:situ_hold, tag, _token} = message, process),
    do: run_consumer(process, tag, message)

  def handle_info({:situ_alarm, due} = message, process) do
    ids = for {id, state} <- process.members, alarm?(state, due), do: id
    run_stages(process, ids, message)
  end

  def handle_info(:situ_turn, %{waiting: waiting} = process),
    do: run_messages(%{process | scheduled: false, waiting: []}, waiting)

  def handle_info({:DOWN, ref, :process, pid, _reason} = message, process) do
    left = for {id, {:moved, ^pid}} <- process.leaving, do: id
    process = %{process | leaving: Map.drop(process.leaving, left)}
    watches? = fn state -> Enum.any?(State.list_subscribers(state), &(&1.monitor == ref)) end
    ids = for {id, state} <- process.members, watches?.(state), do: id
    run_stages(process, ids, message)
  end

  # Light stages take no plain messages.
  def handle_info(_message, process), do: {:noreply, process}

  @impl true
  def handle_call(:"$estimate_buffered_count", _from, process) do
    counts =
      for {_id, state} <- process.members,
          do: Outputs.buffered_count(elem(State.last_step(state), 1).outputs)

    {:reply, Enum.sum(counts), process}
  end

  def handle_call(_request, _from, process), do: {:noreply, process}

  @impl true
  def handle_cast({:"$demand", _mode} = request, process) do
    members =
      Map.new(process.members, fn {id, state} ->
        {:noreply, state} = Stage.handle_cast(request, state)
        {id, state}
      end)

    run_messages(%{process | members: members}, [])
  end

  def handle_cast(_request, process), do: {:noreply, process}

  @impl true
  def terminate(reason, process),
    do: for({_id, state} <- process.members, do: Stage.terminate(reason, state))

  @impl true
  def format_status(reason, [dictionary, %__MODULE__{members: members}]) do
    [
      data:
        Enum.flat_map(members, fn {_id, state} ->
          Stage.format_status(reason, [dictionary, state])[:data]
        end)
    ]
  end

  defp alarm?(state, due) do
    Enum.any?(State.list_steps(state), &match?(%{timers: %Timers{alarm: {^due, _, _}}}, &1))
  end

  defp run_consumer(%{consumers: consumers} = process, tag, message) do
    case consumers do
      %{^tag => id} ->
        run_stage(process, id, message)

      _ ->
        found = Enum.find(process.members, fn {_id, state} -> State.find_input(state, tag) end)
        run_found(process, found, &%{&1 | consumers: Map.put(consumers, tag, &2)}, message)
    end
  end

  defp run_producer(%{producers: producers} = process, tag, message) do
    case producers do
      %{^tag => id} ->
        run_stage(process, id, message)

      _ ->
        feeds? = fn {_id, state} -> Enum.any?(State.list_subscribers(state), &(&1.tag == tag)) end
        found = Enum.find(process.members, feeds?)
        run_found(process, found, &%{&1 | producers: Map.put(producers, tag, &2)}, message)
    end
  end

  # Any stage refuses a message about an unknown connection; stages that have left do not know of it either.
  defp run_found(%{members: members} = process, nil, _remember, _message) when members == %{},
    do: {:noreply, process}

  defp run_found(%{members: members} = process, nil, _remember, message) do
    {id, _state} = Enum.min(members)
    run_stage(process, id, message)
  end

  defp run_found(process, {id, _state}, remember, message),
    do: process |> remember.(id) |> run_stage(id, message)

  defp run_stage(process, id, message), do: run_messages(process, [{id, message}])
  defp run_stages(process, ids, message), do: run_messages(process, Enum.map(ids, &{&1, message}))

  # Messages of other processes, such as requests, come before messages that wait for another time slice.
  defp run_messages(%{scheduled: true} = process, messages) do
    process = messages |> handle_messages(process) |> run_ready()
    end_slice(%{process | waiting: process.waiting ++ Address.take_local()})
  end

  defp run_messages(process, messages) do
    deadline = Runtime.monotonic_time() + @slice_ns
    messages |> run_rounds(process, deadline) |> end_slice()
  end

  defp end_slice(%{members: members, leaving: leaving} = process)
       when members == %{} and leaving == %{},
       do: {:stop, :normal, process}

  defp end_slice(%{scheduled: true} = process), do: {:noreply, process}

  defp end_slice(%{waiting: [], sources: []} = process),
    do: {:noreply, %{process | saturated: 0}}

  defp end_slice(process), do: {:noreply, process |> Departure.check_load() |> schedule_slice()}

  defp schedule_slice(process) do
    send(self(), :situ_turn)
    %{process | scheduled: true}
  end

  # In each round, all messages are handled, and then the stages run that have received any.
  defp run_rounds(messages, process, deadline) do
    process = messages |> handle_messages(process) |> run_ready()

    case {Address.take_local(), process.sources} do
      {[], []} ->
        process

      {messages, sources} ->
        cond do
          Runtime.monotonic_time() > deadline -> %{process | waiting: messages}
          messages != [] -> run_rounds(messages, process, deadline)
          true -> run_rounds([], %{process | ready: sources, sources: []}, deadline)
        end
    end
  end

  defp handle_messages([], process), do: process

  defp handle_messages([{id, message} | rest], %{members: members} = process) do
    case members do
      %{^id => state} when not is_map_key(process.paused, id) ->
        handle_messages(rest, handle_message(message, id, state, process))

      %{^id => state} ->
        {deferred, process} = handle_paused(message, id, state, process)
        handle_messages(deferred ++ rest, process)

      _has_left_or_ended ->
        handle_messages(rest, Departure.forward(process, id, message))
    end
  end

  defp run_ready(%{ready: []} = process), do: process

  defp run_ready(%{ready: ready} = process) do
    now = Runtime.monotonic_time()
    ready |> :lists.reverse() |> run_ready(%{process | ready: []}, now)
  end

  defp run_ready([], process, _now), do: process

  defp run_ready([id | rest], %{members: members} = process, started) do
    case members do
      %{^id => state} ->
        state = Loop.run_slice(%{state | ready: false})
        now = Runtime.monotonic_time()
        state = Load.add_run(state, now - started)
        run_ready(rest, put_result(process, id, state), now)

      _has_ended ->
        run_ready(rest, process, started)
    end
  end

  defp put_result(process, id, state) do
    cond do
      State.over?(state) -> remove_member(process, id, state)
      Load.blocking?(state) -> Departure.begin(process, id, state)
      true -> put_member(process, id, state)
    end
  end

  defp put_ready(process, id, %{ready: true} = state), do: put_member(process, id, state)

  defp put_ready(process, id, %{steps: steps} = state) do
    state = %{state | ready: true}

    if elem(steps, 0).source.kind == :pull,
      do: put_member(%{process | sources: [id | process.sources]}, id, state),
      else: put_member(%{process | ready: [id | process.ready]}, id, state)
  end

  # Messages and demand wait until the stage's time slice, which is one for all of them.
  defp handle_message({:"$gen_consumer", {_, tag}, batches}, id, state, process)
       when is_list(batches) do
    case State.find_input(state, tag) do
      nil -> process
      {i, input} -> put_ready(process, id, State.put_input(state, i, Input.push(input, batches)))
    end
  end

  defp handle_message({:"$gen_producer", from, {:ask, n}} = message, id, state, process)
       when is_integer(n) and n > 0 do
    case State.update_outputs(state, &Outputs.add_demand(&1, from, n)) do
      {:ok, state} -> put_ready(process, id, Subscriptions.wake_sources(state))
      :error -> call_stage(message, id, state, process)
    end
  end

  defp handle_message(:situ_turn, id, state, process),
    do: put_ready(process, id, %{state | scheduled: false})

  defp handle_message({:situ, {:freeze, ref}}, id, state, process) do
    state = RequestHandler.prepare_pause(state, ref)
    Runtime.send_after({:situ, {:to, id, {:thaw, ref}}}, Pause.longest_ms(), :background)
    # A time slice only sends pending messages while another one is due.
    process = put_member(process, id, %{state | scheduled: true})
    put_pause(process, id, {ref, state.scheduled, [], []})
  end

  defp handle_message({:situ, :relocate}, id, state, process),
    do: Departure.begin(process, id, state)

  defp handle_message(message, id, state, process), do: call_stage(message, id, state, process)

  defp call_stage(message, id, state, process) do
    case Stage.handle_info(message, state) do
      {:noreply, state} -> put_member(process, id, state)
      {:stop, :normal, state} -> remove_member(process, id, state)
    end
  end

  # Returns messages to handle before all others, and the process.
  defp handle_paused({:situ, {:thaw, ref}}, id, state, %{paused: paused} = process) do
    case Map.fetch!(paused, id) do
      {^ref, scheduled?, deferred, actions} ->
        state = RequestHandler.resume_after_pause(%{state | scheduled: scheduled?}, actions)
        deferred = for message <- Enum.reverse(deferred), do: {id, message}
        {deferred, put_member(%{process | paused: Map.delete(paused, id)}, id, state)}

      _another_pause ->
        {[], process}
    end
  end

  defp handle_paused({:"$gen_producer", _from, {:ask, _n}} = message, id, state, process),
    do: {[], handle_message(message, id, state, process)}

  defp handle_paused({:situ, {:refresh, _from}} = message, id, state, process),
    do: {[], handle_message(message, id, state, process)}

  defp handle_paused({:situ, request}, id, state, process) when Pause.change(request) do
    {state, more} = RequestHandler.change(request, state)
    process = put_member(process, id, state)

    {ref, scheduled?, kept, actions} = Map.fetch!(process.paused, id)
    {[], put_pause(process, id, {ref, scheduled?, kept, actions ++ more})}
  end

  defp handle_paused(message, id, _state, process) do
    {ref, scheduled?, kept, actions} = Map.fetch!(process.paused, id)
    {[], put_pause(process, id, {ref, scheduled?, [message | kept], actions})}
  end

  defp put_pause(%{paused: paused} = process, id, pause),
    do: %{process | paused: Map.put(paused, id, pause)}

  defp put_member(%{members: members} = process, id, state),
    do: %{process | members: %{members | id => state}}

  # The server learns of the end of a stage in this way as long as the process continues.
  defp remove_member(%{members: members} = process, id, state) do
    Stage.terminate(:normal, state)
    Step.report_event(elem(state.steps, 0), :ended)
    %{process | members: Map.delete(members, id), paused: Map.delete(process.paused, id)}
  end
end
