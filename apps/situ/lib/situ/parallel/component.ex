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
        running: opts.strategy.new(opts, context),
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

    hold_or_resume(outputs, %{state | core: Branches.send_parts(core)})
  end

  @impl true
  def handle_info({:situ_branch_failed, error}, _context, _state), do: raise(error)

  def handle_info({:hold_ended, :in}, _context, %{held?: true, core: core} = state) do
    if state.moved? or working?(core),
      do: {[{:hold, :in}], %{state | moved?: false}},
      else: {[], %{state | held?: false, limit: state.limit * 2}}
  end

  def handle_info(message, _context, state) do
    case Branches.read_event(state.core, message) do
      nil ->
        {[], state}

      result ->
        {outputs, state} = handle_events(result, state, [])
        hold_or_resume(outputs, state)
    end
  end

  # A branch that reports every part will report those that wait for it.
  defp working?(core) do
    awaited = Branches.awaited_branches(core)

    Enum.any?(Branches.pipelines(core), fn {branch, pid, reports?} ->
      branch in awaited and (reports? or Client.call(pid, :quiet?) != true)
    end)
  end

  # Handles all events that are already in the mailbox, in one time slice.
  defp handle_events({event, core}, state, outputs) do
    {more, state} = handle_event(event, %{state | core: core})
    outputs = [more | outputs]

    case Branches.await_event(state.core, 0) do
      nil -> {outputs |> :lists.reverse() |> :lists.append(), state}
      result -> handle_events(result, state, outputs)
    end
  end

  defp handle_event(event, state) do
    {outputs, core} = Branches.handle_event(state.core, event)
    raise_later(event, state.opts)
    {outputs, %{state | core: core, moved?: true}}
  end

  # The error is raised with the next message, so that the state without the branch is kept for any `on_error:`.
  defp raise_later({:ended, _key, _branch, {:error, error}}, %{on_branch_error: :stop}),
    do: send(self(), {:situ_branch_failed, error})

  defp raise_later(_event, _opts), do: :ok

  # The outputs of parts that are still in the branches must be emitted before this operator ends.
  @impl true
  def handle_closed(_input, time, context, state) do
    {outputs, core} = Branches.close_input(state.core, time)
    state = %{state | core: Branches.send_parts(core)}
    drain_branches(state, context.pipeline, nil, [outputs])
  end

  # Waits until every branch has ended, however long the branches take for their remaining messages. It keeps reporting
  # progress to the surrounding pipeline.
  defp drain_branches(state, pipeline, marks, outputs) do
    cond do
      Branches.pipelines(state.core) == [] ->
        finish_drain(state, outputs)

      result = Branches.await_event(state.core, 1_000) ->
        {more, state} = handle_events(result, state, [])
        Client.report_movement(pipeline)
        drain_branches(state, pipeline, marks, [more | outputs])

      true ->
        now = for {_, pid, _} <- Branches.pipelines(state.core), do: Client.call(pid, :mark)
        if now != marks, do: Client.report_movement(pipeline)
        drain_branches(state, pipeline, now, outputs)
    end
  end

  defp finish_drain(state, outputs) do
    receive do
      {:situ_branch_failed, error} -> raise error
    after
      0 -> {outputs |> :lists.reverse() |> :lists.append(), state}
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
    do: for({_, pid, _} <- Branches.pipelines(core), do: send(pid, :situ_stop))

  @impl true
  def snapshot(%{core: core, path: path}), do: Branches.take_snapshot(core, path)

  @impl true
  def restore(plain, %{core: core, path: path} = state) do
    with {:ok, core} <- Branches.restore_snapshot(core, plain, path),
         do: {:ok, %{state | core: core}}
  end

  @impl true
  def describe(%{core: nil}), do: "not started"

  def describe(%{core: core}) do
    live = "#{map_size(core.branches)} branches live"
    kind = if core.strategy == Situ.Parallel.Values, do: "", else: ", each its own pipeline"
    counts = [ending: map_size(core.ending), failed: core.failed]
    more = for {what, n} when n > 0 <- counts, do: ", #{n} #{describe_count(what)}"
    waiting = PendingOutputs.waiting_count(core.pending)
    waits = if waiting > 0, do: ", #{waiting} messages wait", else: ""
    "#{live}#{kind}, #{core.started} started#{more}#{waits}"
  end

  defp describe_count(:ending), do: "ending"
  defp describe_count(:failed), do: "failed and restarted"

  @doc "Returns the pipelines of the branches on this node."
  @spec branch_pipelines(%__MODULE__{}) :: [pid()]
  def branch_pipelines(%__MODULE__{core: nil}), do: []

  def branch_pipelines(%__MODULE__{core: core}),
    do: for({_, pid, _} <- Branches.pipelines(core), node(pid) == node(), do: pid)
end
