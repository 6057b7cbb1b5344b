defmodule Situ.Pipeline.State do
  @moduledoc false
  # The state of a pipeline's server.
  #
  #   life      the life cycle, a pure state machine
  #   stages    the stages by id; pids: the stages of each process
  #   wires     links: connections between stages with their policies; counters: their counters, in shared memory
  #   dynamic   pending requests that change the running pipeline
  #   view      the data kept for inspection: Situ.Pipeline.Inspection
  #   waiters   callers that wait for the end
  #   early     messages deferred until the pipeline is running
  #   code      the version of the pipeline's module, and the process that renews its functions: Dynamic.Reload
  alias Situ.{Error, Graph, Lifecycle, Options}
  alias Situ.Clock.Timing
  alias Situ.Lifecycle.Errors
  alias Situ.Pipeline.{Dynamic, Inspection, Settings}

  @enforce_keys [:settings, :life, :view]
  defstruct [
    :settings,
    :handle,
    :owner,
    :result,
    :timing,
    :life,
    :view,
    :handlers,
    graph: %Graph{},
    stages: %{},
    pids: %{},
    wires: %{links: %{}, counters: %{}},
    dynamic: %Dynamic{},
    waiters: [],
    early: [],
    code: {nil, nil}
  ]

  @typedoc "An output: its vertex and its name."
  @type port_id :: {pos_integer(), atom()}
  @type stage :: %{
          id: pos_integer(),
          pid: pid() | nil,
          group: pos_integer() | nil,
          shared?: boolean(),
          left: pid() | nil,
          vertices: [Situ.Graph.Vertex.t(), ...],
          tally: Situ.Ports.ErrorCounters.t(),
          control: :atomics.atomics_ref(),
          marks: :atomics.atomics_ref() | nil,
          tail: Situ.Ports.Counters.t() | nil,
          started: Situ.Time.t() | nil,
          memory: Situ.Stage.Checkpoint.t() | nil,
          stopped: %{(:before | :after) => {:ok, Situ.Stage.Checkpoint.t()} | {:error, Error.t()}}
        }

  @type t :: %__MODULE__{
          settings: Settings.t(),
          handle: Situ.Graph.Handle.t() | nil,
          owner: reference() | nil,
          result: term(),
          timing: Timing.t() | nil,
          life: Lifecycle.State.t(),
          view: Inspection.t(),
          handlers: pid() | nil,
          graph: Situ.Graph.t(),
          stages: %{pos_integer() => stage()},
          pids: %{pid() => [pos_integer(), ...]},
          wires: %{links: %{term() => map()}, counters: %{term() => Situ.Ports.Counters.t()}},
          dynamic: Dynamic.t(),
          waiters: [GenServer.from()],
          early: [term()],
          code: {binary() | nil, pid() | nil}
        }

  @spec new(Settings.t()) :: t()
  def new(settings) do
    life = %Lifecycle.State{
      mode: settings.mode,
      limits: %{
        restarts: {settings.max_restarts, settings.max_seconds * 1_000},
        stop_timeout: settings.stop_timeout
      }
    }

    %__MODULE__{
      settings: settings,
      life: life,
      view: %Inspection{begun: System.monotonic_time()},
      graph: %Graph{default_policy: settings.default_policy, replay: settings.interval}
    }
  end

  @doc "Returns the pipeline's time; wall time before it has a clock."
  @spec now(t()) :: Situ.Time.t()
  def now(%{timing: nil}), do: :os.system_time()
  def now(state), do: Situ.Clock.now(state.timing.clock)

  # The following functions find the parts of a running pipeline: the vertex and output of a stream, and its stage and
  # position in the chain.

  @doc "Returns the vertex and output of a stream, given as that pair or by name."
  @spec fetch_port(t(), port_id() | String.t()) :: {:ok, port_id()} | {:error, Error.t()}
  def fetch_port(state, {id, output}) do
    if Map.has_key?(state.graph.vertices, id),
      do: {:ok, {id, output}},
      else: {:error, Errors.not_running()}
  end

  def fetch_port(state, name) do
    named = Graph.StreamNames.map_names(state.graph)

    case named do
      %{^name => port} -> {:ok, port}
      _ -> {:error, Graph.unknown_stream(name, Map.keys(named))}
    end
  end

  @doc "Returns the vertex of a component, given as a node or by path."
  @spec fetch_vertex(t(), Situ.Node.t() | String.t()) ::
          {:ok, Situ.Graph.Vertex.t()} | {:error, Error.t()}
  def fetch_vertex(state, %Situ.Node{id: id, path: path}) do
    case state.graph.vertices do
      %{^id => vertex} -> {:ok, vertex}
      _ -> {:error, Errors.unknown_component(path, nil)}
    end
  end

  def fetch_vertex(%{graph: %{paths: paths} = graph}, path) do
    case paths do
      %{^path => id} ->
        Map.fetch(graph.vertices, id)

      _ ->
        near = is_binary(path) && Options.nearest_name(path, Map.keys(paths))
        {:error, Errors.unknown_component(path, near || nil)}
    end
  end

  @doc "Returns the running stage that contains a vertex, and the vertex's index in it."
  @spec fetch_stage(t(), pos_integer()) ::
          {:ok, stage(), non_neg_integer()} | {:error, Error.t()}
  def fetch_stage(state, id) do
    found =
      Enum.find_value(state.stages, fn {_, stage} ->
        index = Enum.find_index(stage.vertices, &(&1.id == id))
        index && {stage, index}
      end)

    with {stage, index} <- found, :running <- state.life.stages[stage.id].status do
      {:ok, stage, index}
    else
      _ -> {:error, Errors.not_running()}
    end
  end

  @doc "Returns the stage whose output is the vertex's output; an error if the vertex is inside a chain."
  @spec fetch_output_stage(t(), pos_integer()) :: {:ok, stage()} | {:error, Error.t()}
  def fetch_output_stage(state, id) do
    with {:ok, stage, index} <- fetch_stage(state, id) do
      if index == length(stage.vertices) - 1,
        do: {:ok, stage},
        else: {:error, inside_chain_error(state.graph.vertices[id].path)}
    end
  end

  @typedoc "A part to stop: the ids of its running stages, and of the stages to remove after they have ended."
  @type part :: %{ids: [pos_integer()], forget: [pos_integer()]}

  @doc """
  Returns the stages below `path`, a composite or a component. A part can be stopped only if at least one of its stages
  is running and is not being stopped already. It can be removed in any state.
  """
  @spec fetch_part(t(), String.t(), boolean()) :: {:ok, part()} | {:error, Error.t()}
  def fetch_part(state, path, forget?) do
    inside = for {_, stage} <- state.stages, stage_in_part?(stage, path, state.graph), do: stage
    alone = for {_, part} <- state.life.parts, id <- part.ids, do: id
    running = Enum.filter(inside, &(stage_running?(&1.id, state) and &1.id not in alone))
    chosen = if forget?, do: inside, else: running

    cond do
      inside == [] ->
        unknown_part(state, path)

      chosen == [] ->
        {:error, ended_error(path)}

      stage = Enum.find(chosen, &shared_with_outside?(&1, path)) ->
        {:error, shared_process_error(stage, path)}

      forget? ->
        {:ok, %{ids: Enum.map(running, & &1.id), forget: Enum.map(inside, & &1.id)}}

      true ->
        {:ok, %{ids: Enum.map(running, & &1.id), forget: []}}
    end
  end

  @doc "Returns the ids of the stages below `path`."
  @spec list_inside(t(), String.t()) :: [pos_integer()]
  def list_inside(state, path),
    do: for({id, stage} <- state.stages, stage_in_part?(stage, path, state.graph), do: id)

  @doc "Returns the stages below `path`, all of which have ended or are being stopped."
  @spec fetch_stopped_part(t(), String.t()) :: {:ok, [pos_integer()]} | {:error, Error.t()}
  def fetch_stopped_part(state, path) do
    case fetch_part(state, path, true) do
      {:ok, %{ids: [], forget: inside}} ->
        # A part that is being removed no longer has a name.
        leaving = for {_ref, part} <- state.life.parts, id <- part.forget, do: id
        if Enum.any?(inside, &(&1 in leaving)), do: unknown_part(state, path), else: {:ok, inside}

      {:ok, _running} ->
        {:error, part_running_error(path)}

      {:error, error} ->
        {:error, error}
    end
  end

  # A removed stage stays until its process has ended, while other stages may already use its names.
  defp stage_in_part?(%{vertices: [head | _] = vertices}, path, graph),
    do: is_map_key(graph.vertices, head.id) and Enum.any?(vertices, &vertex_within?(&1, path))

  defp stage_running?(id, %{life: %{stages: stages}}) do
    %{status: status, alive?: alive?} = stages[id]
    status == :restarting or (alive? and status in [:running, :closed])
  end

  defp vertex_within?(vertex, path),
    do: vertex.path == path or String.starts_with?(vertex.path, path <> ".")

  defp shared_with_outside?(stage, path),
    do: not Enum.all?(stage.vertices, &vertex_within?(&1, path))

  defp unknown_part(state, path), do: {:error, unknown_part_error(state, path)}

  defp unknown_part_error(state, path) do
    near = Options.nearest_name(path, Map.keys(state.graph.scopes) ++ Map.keys(state.graph.paths))

    Error.new(:unknown_component, "no composite or component #{inspect(path)}",
      fix: near && "did you mean #{inspect(near)}?"
    )
  end

  defp ended_error(path) do
    Error.new(:not_running, "#{path} has ended, or is being stopped",
      fix: "to remove it from the pipeline, call Situ.Pipeline.remove/3"
    )
  end

  defp part_running_error(path) do
    Error.new(:still_running, "#{path} cannot be started because a part of it is running",
      fix: "stop all of it first, with Situ.Pipeline.stop_part/3"
    )
  end

  defp inside_chain_error(path) do
    Error.new(
      :inside_chain,
      "#{path} runs inside a chain of operators and has no output outside its process",
      fix: "run it in a separate process with async: true, or inspect it with Situ.attach_tap/3"
    )
  end

  defp shared_process_error(stage, path) do
    {inside, outside} = Enum.split_with(stage.vertices, &vertex_within?(&1, path))

    Error.new(
      :shared_process,
      "#{hd(inside).path} shares a process with #{hd(outside).path}, which is not part of #{path}",
      why: "a process can only end as a whole",
      fix: "give the later one async: true, or a policy that is not synchronous",
      meta: %{component: path}
    )
  end
end
