defmodule Situ.Stage.Setup do
  @moduledoc false
  # Making a stage's state, wiring it, and changing what it runs. Pure but for the component's own callbacks.
  alias Situ.{Error, Options, Stage}
  alias Situ.Graph.Vertex
  alias Situ.Operator.Chain
  alias Situ.Stage.{Call, Inlet, Marks, Outlet, Subscriber}

  @spec state(map()) :: Stage.t()
  def state(%{vertices: [head | _] = vertices} = args) do
    %Stage{
      id: args.id,
      server: args.server,
      kind: if(head.module == :operator, do: :chain, else: :component),
      vertices: vertices,
      head: head,
      module: head.module,
      opts: head.opts,
      tally: args.tally,
      batch: head.module != :operator and function_exported?(head.module, :handle_messages, 4),
      context: Stage.context(args),
      source: source(head),
      tail: tail(vertices, args),
      outlets: vertices |> outlets() |> marked(args[:marks])
    }
  end

  # Light operators that run behind a component, in its process: a chain, and the counters of the edge into it.
  defp tail([%{module: :operator} | _], _args), do: nil
  defp tail([_component], _args), do: nil

  defp tail([_component | operators], args) do
    chain = operators |> Enum.map(& &1.opts) |> Chain.new(1)

    %{
      chain: chain,
      fast: not Chain.stateful?(chain),
      counters: args[:tail_counters],
      sizes: args[:sizes]
    }
  end

  # With a tail the component's own output has no subscribers; what comes out of the tail has the key {:tail, name}.
  defp outlets([%{module: :operator} | _] = vertices) do
    last = List.last(vertices)
    Map.new(last.outputs, &outlet(&1, last))
  end

  defp outlets([component]), do: Map.new(component.outputs, &outlet(&1, component))

  defp outlets([component | operators]) do
    last = List.last(operators)
    [{name, outlet}] = Enum.map(last.outputs, &outlet(&1, last))
    component.outputs |> Map.new(&outlet(&1, component)) |> Map.put({:tail, name}, outlet)
  end

  defp marked(outlets, marks) do
    outlets
    |> Enum.sort_by(&elem(&1, 0))
    |> Enum.with_index()
    |> Map.new(fn {{key, outlet}, index} -> {key, Marks.attach(outlet, marks, index)} end)
  end

  @doc "The component's first state, or the chain compiled."
  @spec core(Stage.t()) :: {:ok, Stage.t()} | {:error, Error.t()}
  def core(%{kind: :chain} = state) do
    chain = Chain.new(Enum.map(state.vertices, & &1.opts))
    {:ok, %{state | chain: chain, fast: not Chain.stateful?(chain)}}
  end

  def core(state) do
    with {:ok, core} <- Call.init(state.module, state.opts, state.head.path),
         do: {:ok, %{state | core: core}}
  end

  @doc "Clock, neighbours and their counters, known when every stage is up."
  @spec wire(Stage.t(), map()) :: Stage.t()
  def wire(state, wiring) do
    outlets =
      Enum.reduce(wiring.subs, state.outlets, fn {output, subs}, outlets ->
        subs = Enum.map(subs, fn {tag, pid, counters} -> Subscriber.new(tag, pid, counters) end)
        Map.update!(outlets, key(state, output), &%{&1 | subs: subs})
      end)

    inlets =
      Map.new(wiring.inlets, fn inlet -> {inlet.tag, new_inlet(state, inlet, wiring.sizes)} end)

    context = %{
      state.context
      | start_time: wiring.start_time,
        now: wiring.start_time,
        replay_start: wiring.replay_start,
        replay_end: wiring.replay_end,
        enforced?: wiring.enforce
    }

    %{
      state
      | clock: wiring.clock,
        control: wiring.control,
        enforce: wiring.enforce,
        context: context,
        outlets: outlets,
        inlets: inlets,
        lossy: Enum.any?(inlets, fn {_, inlet} -> inlet.lossy end)
    }
  end

  defp key(%{tail: nil}, output), do: output
  defp key(_state, output), do: {:tail, output}

  @doc "A neighbour was restarted under another pid."
  @spec rewire(Stage.t(), term(), pid()) :: Stage.t()
  def rewire(state, tag, pid) do
    inlets =
      case state.inlets do
        %{^tag => inlet} -> %{state.inlets | tag => %{inlet | producer: pid, owed: 0}}
        inlets -> inlets
      end

    outlets =
      Map.new(state.outlets, fn {name, outlet} ->
        subs =
          Enum.map(outlet.subs, &if(&1.tag == tag, do: %{&1 | pid: pid, demand: 0}, else: &1))

        {name, %{outlet | subs: subs}}
      end)

    %{state | inlets: inlets, outlets: outlets}
  end

  @doc "The output a subscriber asks for with `output: name`; the only one needs no name."
  @spec find_outlet(Stage.t(), keyword()) :: {:ok, Outlet.t()} | {:error, Error.t()}
  def find_outlet(state, opts) do
    outlets =
      for {key, outlet} <- state.outlets, reachable?(state, key), do: {outlet.name, outlet}

    case {Keyword.fetch(opts, :output), outlets} do
      {:error, [{_, outlet}]} -> {:ok, outlet}
      {:error, _} -> {:error, no_outlet(state, opts)}
      {{:ok, name}, outlets} -> named(List.keyfind(outlets, name, 0), state, opts)
    end
  end

  defp reachable?(%{tail: nil}, _key), do: true
  defp reachable?(_state, key), do: is_tuple(key)

  defp named({_, outlet}, _state, _opts), do: {:ok, outlet}
  defp named(nil, state, opts), do: {:error, no_outlet(state, opts)}

  @doc "New options or another module for one component; the state is carried over by `migrate/3`."
  @spec replace(Stage.t(), non_neg_integer(), module(), keyword() | Situ.Operator.step()) ::
          {:ok, Stage.t(), list()} | {:error, Error.t()}
  def replace(%{kind: :chain} = state, index, :operator, step) do
    vertices = List.update_at(state.vertices, index, &%{&1 | opts: step})
    chain = exchange(state.chain, index, step)
    {:ok, %{state | vertices: vertices, chain: chain, fast: not Chain.stateful?(chain)}, []}
  end

  def replace(%{tail: %{chain: chain} = tail} = state, index, :operator, step) do
    vertices = List.update_at(state.vertices, index, &%{&1 | opts: step})
    chain = exchange(chain, index, step)
    tail = %{tail | chain: chain, fast: not Chain.stateful?(chain)}
    {:ok, %{state | vertices: vertices, tail: tail}, []}
  end

  def replace(state, 0, module, opts) do
    path = state.head.path

    with {:ok, opts} <- Options.validate(opts, module.options()),
         {:ok, core, actions} <- migrate(state, module, opts, path) do
      head = %{state.head | module: module, opts: opts}
      {:ok, %{swap(state, head) | core: core}, actions}
    end
  end

  defp exchange(chain, index, step) do
    [fresh] = Chain.new([step], index)
    Enum.map(chain, &if(elem(&1, 2) == index, do: fresh, else: &1))
  end

  defp swap(state, head) do
    batch = function_exported?(head.module, :handle_messages, 4)

    %{
      state
      | head: head,
        vertices: [head | tl(state.vertices)],
        module: head.module,
        opts: head.opts,
        batch: batch
    }
  end

  @doc "One line about the component's state."
  @spec describe(Stage.t()) :: String.t() | nil
  def describe(%{kind: :component} = state) do
    if function_exported?(state.module, :describe, 1), do: state.module.describe(state.core)
  rescue
    error -> "describe failed: " <> Exception.message(error)
  end

  def describe(_state), do: nil

  defp migrate(state, module, opts, path) do
    if function_exported?(module, :migrate, 3),
      do: carry(state, module, opts, path),
      else: fresh(state, module, opts, path)
  end

  defp carry(state, module, opts, path) do
    case module.migrate(state.core, state.opts, opts) do
      {:ok, core} -> {:ok, core, []}
      {:error, %Error{} = error} -> {:error, Call.located(error, path)}
    end
  rescue
    error -> {:error, Call.failure(path, "migrate", :error, error, __STACKTRACE__)}
  end

  defp fresh(state, module, opts, path) do
    with {:ok, core} <- Call.init(module, opts, path),
         {:ok, actions, core} <- Call.run(module, :handle_start, [state.context, core], path) do
      Call.terminate(state.module, :replaced, state.core, path)
      {:ok, core, actions}
    end
  end

  defp source(%{module: :operator}), do: nil

  defp source(%Vertex{} = head) do
    cond do
      function_exported?(head.module, :handle_demand, 3) -> :pull
      head.inputs == [] -> :push
      true -> nil
    end
  end

  defp outlet({name, port}, vertex),
    do:
      {name,
       %Outlet{
         name: name,
         path: vertex.path,
         source_id: port.source_id,
         same_time: vertex.on_same_time
       }}

  defp new_inlet(state, inlet, sizes) do
    port = Keyword.fetch!(state.head.inputs, inlet.name)
    extra = %{type: port.type, check: state.head.check, counters: inlet.counters, sizes: sizes}
    Inlet.new(inlet.name, inlet.tag, inlet.producer, inlet.policy, extra)
  end

  defp no_outlet(state, opts) do
    known = state.outlets |> Map.values() |> Enum.map_join(", ", &inspect(&1.name))

    Error.new(:unknown_output, "#{state.head.path} has no output #{inspect(opts[:output])}",
      fix: "subscribe with output: one of " <> known
    )
  end
end
