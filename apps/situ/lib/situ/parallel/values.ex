defmodule Situ.Parallel.Values do
  @moduledoc false
  # The component of parallel, which contains all branches.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: :any, required: true, doc: "A function of a stream, or of a key and a stream."],
      type: [type: :any, default: :any],
      form: [type: :any, required: true],
      split: [type: {:optional, {:fun, 1}}],
      with: [type: {:optional, {:fun, 1}}],
      termination: [type: :any, default: :never],
      missing: [type: :any, default: :drop],
      on_branch_error: [type: {:in, [:stop, :restart]}, default: :stop]
    ]

  alias Situ.Parallel.{ValueBranches, Parts}

  @many 1_000
  @roomy {__MODULE__, :roomy}

  @impl true
  def init(opts), do: {:ok, {nil, Map.new(opts)}}

  @impl true
  def handle_start(context, {nil, opts}), do: {[], {build_core(opts, context), opts}}

  @impl true
  def handle_message(_input, message, _context, {core, opts}) do
    parts = Parts.split_parts(opts.form, opts[:split], message.data)
    make_room(core, parts)
    {outputs, core} = ValueBranches.push_message(core, message, parts)
    {outputs, {core, opts}}
  end

  @impl true
  def handle_messages(_input, messages, _context, {core, opts}) do
    {outputs, core} =
      Enum.flat_map_reduce(messages, core, fn message, core ->
        parts = Parts.split_parts(opts.form, opts[:split], message.data)
        make_room(core, parts)
        ValueBranches.push_message(core, message, parts)
      end)

    {outputs, {core, opts}}
  end

  @impl true
  def handle_closed(_input, time, _context, {core, opts}) do
    {outputs, core} = ValueBranches.close_input(core, time)
    {outputs, {core, opts}}
  end

  @impl true
  def describe({nil, _opts}), do: "not started"

  def describe({core, _opts}) do
    failed = if core.failed > 0, do: ", #{core.failed} failed and restarted", else: ""
    waiting = Situ.Parallel.PendingOutputs.waiting_count(core.entries)
    waits = if waiting > 0, do: ", #{waiting} messages wait", else: ""
    "#{map_size(core.branches)} branches live, #{core.started} started#{failed}#{waits}"
  end

  # A process with very many branches must not copy all of them in every garbage collection. From @many branches on, it
  # does a full sweep only when the old heap is full, and has a young heap large enough for several messages' garbage.
  defp make_room(%{branches: branches}, parts)
       when is_map(parts) and map_size(branches) + map_size(parts) > @many do
    if Process.get(@roomy) == nil do
      Process.put(@roomy, true)
      Process.flag(:fullsweep_after, 65_535)
      Process.flag(:min_heap_size, 1_000_000)
    end

    :ok
  end

  defp make_room(_core, _parts), do: :ok

  defp build_core(opts, context) do
    ValueBranches.new(
      start: branch_starter(opts, context),
      form: opts.form,
      termination: opts.termination,
      missing: opts.missing,
      creator: opts[:with] || (& &1),
      on_failure: opts.on_branch_error
    )
  end

  defp branch_starter(%{fun: fun, type: type}, context) do
    shared = [seed: Situ.Branch.build_seed(type), context: context]
    start = fn key, fun -> Situ.Branch.start(fun, [path: {context.path, key}] ++ shared) end

    if is_function(fun, 1),
      do: fn key -> start.(key, fun) end,
      else: fn key -> start.(key, &fun.(key, &1)) end
  end
end
