defmodule Situ.Pipeline.State do
  @moduledoc false
  # What the server of a pipeline holds.
  #
  #   life      the life cycle, a pure state machine; stages: what runs, by id; pids: whose process is which
  #   links     connections between stages, with their policies; counters: their numbers, in shared memory
  #   dynamic   requests under way that change the running pipeline
  #   view      what is remembered for those who look: Situ.Pipeline.Inspection
  #   waiters   who waits for the end; early: messages that wait until it runs
  alias Situ.Pipeline.{Dynamic, Inspection, Lifecycle, Settings, Timing}

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
    graph: %Situ.Graph{},
    stages: %{},
    pids: %{},
    wires: %{links: %{}, counters: %{}},
    dynamic: %Dynamic{},
    waiters: [],
    early: []
  ]

  @type stage :: %{
          id: pos_integer(),
          pid: pid(),
          vertices: [Situ.Graph.Vertex.t(), ...],
          tally: Situ.Stage.Tally.t(),
          control: :atomics.atomics_ref(),
          marks: :atomics.atomics_ref() | nil,
          tail: Situ.Stage.Counters.t() | nil
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
          pids: %{pid() => pos_integer()},
          wires: %{links: %{term() => map()}, counters: %{term() => Situ.Stage.Counters.t()}},
          dynamic: Dynamic.t(),
          waiters: [GenServer.from()],
          early: [term()]
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
      graph: %Situ.Graph{default_policy: settings.default_policy, replay: settings.interval}
    }
  end

  @doc "The pipeline's time; wall time before it has a clock."
  @spec now(t()) :: Situ.Time.t()
  def now(%{timing: nil}), do: :os.system_time()
  def now(state), do: Situ.Clock.now(state.timing.clock)
end
