defmodule Situ.Parallel.Component do
  @moduledoc false
  # The component of parallel. The pure `Branches` decides, and a strategy runs the branches.
  #
  # If branches are asynchronous, the number of messages with undecided outputs is limited: when it reaches the limit,
  # the input is held. If nothing arrives although no branch is working, the branches need more input (for a window or a
  # filter). The input is then released and the limit doubled.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: :any, required: true, doc: "A function of a stream, or of a key and a stream."],
      strategy: [type: :any, required: true, doc: "A module with the behaviour of a strategy."],
      type: [type: :any, default: :any],
      form: [type: :any, required: true],
      split: [type: {:optional, {:fun, 1}}],
      with: [type: {:optional, {:fun, 1}}],
      termination: [type: :any, required: true],
      missing: [type: :any, default: :drop],
      on_branch_error: [type: {:in, [:stop, :restart]}, default: :stop],
      branch_policy: [type: {:optional, {:struct, Situ.Delivery}}],
      choose_node: [type: {:optional, {:fun, 1}}]
    ]

  alias Situ.Parallel.{Branches, Parts, PendingOutputs}
  alias Situ.Pipeline.Client

  defstruct [:opts, :core, :path, :limit, held?: false, moved?: true]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(context, %{opts: opts} = state) do
    core =
      Branches.new(
        strategy: opts.strategy,
        running: opts.strategy.build_state(opts, context),
        form: opts.form,
        termination: opts.termination,
        missing: opts.missing,
        creator: opts[:with] || (& &1),
        on_failure: opts.on_branch_error
      )

    {[], %{state | core: core, path: context.path, limit: opts.strategy.waiting_limit()}}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  # If a message fails, nothing has been sent, and branches that it has started are unknown to the unchanged state.
  @impl true
  def handle_messages(_input, messages, _context, %{opts: opts} = state) do
    {outputs, core} =
      Enum.flat_map_reduce(messages, state.core, fn message, core ->
        parts = Parts.split_parts(opts.form, opts[:split], message.data)
        Branches.push_message(core, message, parts)
      end)

    hold_or_resume(outputs, %{state | core: send_parts(core)})
  end

  defp send_parts(core), do: %{core | running: core.strategy.send_parts(core.running)}

  @impl true
  def handle_info({:situ_branch_failed, error}, _context, _state), do: raise(error)

  def handle_info({:hold_ended, :in}, _context, %{held?: true, core: core} = state) do
    if state.moved? or working?(core),
      do: {[{:hold, :in}], %{state | moved?: false}},
      else: {[], %{state | held?: false, limit: state.limit * 2}}
  end

  def handle_info(message, _context, %{core: core} = state) do
    case core.strategy.read_event(core.running, message) do
      nil ->
        {[], state}

      result ->
        {outputs, state} = handle_events(result, state, [])
        hold_or_resume(outputs, state)
    end
  end

  # A branch that reports every part will also report the parts for which the output waits.
  defp working?(core) do
    awaited = MapSet.new(Branches.awaited_branches(core))

    Enum.any?(list_pipelines(core), fn {branch, pid, reports?} ->
      branch in awaited and (reports? or Client.call(pid, :quiet?) != true)
    end)
  end

  defp list_pipelines(core), do: core.strategy.list_pipelines(core.running)

  # Handles all events that are already in the mailbox, in one time slice.
  defp handle_events({event, running}, state, outputs) do
    {more, core} = Branches.handle_event(%{state.core | running: running}, event)
    raise_later(event, state.opts)
    outputs = [more | outputs]

    case core.strategy.await_event(core.running, 0) do
      nil -> {concat_outputs(outputs), %{state | core: core, moved?: true}}
      result -> handle_events(result, %{state | core: core}, outputs)
    end
  end

  defp concat_outputs(outputs), do: outputs |> :lists.reverse() |> :lists.append()

  # The error is raised with the next message, so that the state without the branch is kept for any `on_error:`.
  defp raise_later({:ended, _key, _branch, {:error, error}}, %{on_branch_error: :stop}),
    do: send(self(), {:situ_branch_failed, error})

  defp raise_later(_event, _opts), do: :ok

  # The outputs of parts that are still in the branches must be emitted before this operator ends.
  @impl true
  def handle_closed(_input, time, context, state) do
    {outputs, core} = Branches.close_input(state.core, time)
    state = %{state | core: send_parts(core)}
    drain_branches(state, context.pipeline, nil, [outputs])
  end

  # Waits until every branch has ended, however long the branches take for their remaining messages. It keeps reporting
  # progress to the surrounding pipeline.
  defp drain_branches(%{core: core} = state, pipeline, marks, outputs) do
    cond do
      list_pipelines(core) == [] ->
        raise_failure()
        {concat_outputs(outputs), state}

      result = core.strategy.await_event(core.running, 1_000) ->
        {more, state} = handle_events(result, state, [])
        Client.report_movement(pipeline)
        drain_branches(state, pipeline, marks, [more | outputs])

      true ->
        now = for {_, pid, _} <- list_pipelines(core), do: Client.call(pid, :mark)
        if now != marks, do: Client.report_movement(pipeline)
        drain_branches(state, pipeline, now, outputs)
    end
  end

  defp raise_failure do
    receive do
      {:situ_branch_failed, error} -> raise error
    after
      0 -> :ok
    end
  end

  defp hold_or_resume(outputs, %{held?: held?, limit: limit} = state) do
    waiting = PendingOutputs.waiting_count(state.core.pending)

    cond do
      not held? and waiting >= limit ->
        {outputs ++ [{:hold, :in}], %{state | held?: true, moved?: false}}

      held? and waiting <= div(limit, 2) ->
        {outputs ++ [{:resume, :in}], %{state | held?: false}}

      true ->
        {outputs, state}
    end
  end

  @impl true
  def terminate(_reason, %{core: nil}), do: :ok

  def terminate(_reason, %{core: core}),
    do: for({_, pid, _} <- list_pipelines(core), do: send(pid, :situ_stop))

  @impl true
  def snapshot(%{core: core, path: path}), do: Branches.take_snapshot(core, path)

  @impl true
  def restore(plain, %{core: core, path: path} = state) do
    with {:ok, core} <- Branches.restore_snapshot(core, plain, path),
         do: {:ok, %{state | core: core}}
  end

  @impl true
  def describe(%{core: nil}), do: "not started"

  def describe(%{core: %{branches: branches} = core}) do
    kind = if core.strategy == Situ.Parallel.Values, do: "", else: ", each its own pipeline"
    ending = max(length(list_pipelines(core)) - map_size(branches), 0)
    waiting = PendingOutputs.waiting_count(core.pending)

    "#{map_size(branches)} branches live#{kind}, #{core.started} started" <>
      describe_count(ending, "ending") <>
      describe_count(core.failed, "failed and restarted") <>
      describe_count(waiting, "messages wait")
  end

  defp describe_count(0, _what), do: ""
  defp describe_count(n, what), do: ", #{n} #{what}"

  @doc "Returns the pipelines of the branches on this node."
  @spec branch_pipelines(%__MODULE__{}) :: [pid()]
  def branch_pipelines(%__MODULE__{core: nil}), do: []

  def branch_pipelines(%__MODULE__{core: core}),
    do: for({_, pid, _} <- list_pipelines(core), node(pid) == node(), do: pid)
end
