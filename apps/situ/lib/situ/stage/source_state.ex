defmodule Situ.Stage.SourceState do
  @moduledoc false
  # Tracks how a source ends. Pure; Production makes it produce and stop.

  @strikes 10

  defstruct [:kind, :completing, :stopping, :final, completed: false, idle: false, strikes: 0]

  @typedoc """
  `kind` is a pull source, a push source, or not a source. `completing` is the last time, reported once no message is
  held back. `stopping` is the progress of a stop. Nothing later than `final` is sent. An `idle` source has no messages
  until an event occurs. `strikes` counts consecutive errors.
  """
  @type t :: %__MODULE__{
          kind: :pull | :push | nil,
          completing: Situ.Time.t() | nil,
          stopping: nil | :asked | :stopping | :held | :done,
          final: Situ.Time.t() | nil,
          completed: boolean(),
          idle: boolean(),
          strikes: non_neg_integer()
        }

  @spec new(Situ.Graph.Vertex.t()) :: t()
  def new(%{module: :operator}), do: %__MODULE__{}

  def new(vertex) do
    cond do
      function_exported?(vertex.module, :handle_demand, 3) -> %__MODULE__{kind: :pull}
      vertex.inputs == [] -> %__MODULE__{kind: :push}
      true -> %__MODULE__{}
    end
  end

  @doc "Wakes an idle source after an event, because it may have messages again."
  @spec wake(t()) :: t()
  def wake(%__MODULE__{idle: false} = source), do: source
  def wake(%__MODULE__{} = source), do: %{source | idle: false}

  @doc "Returns whether the source may be asked for messages."
  @spec can_produce?(t()) :: boolean()
  def can_produce?(%__MODULE__{kind: :pull, completed: false, idle: false, stopping: stopping}),
    do: stopping in [nil, :stopping]

  def can_produce?(%__MODULE__{}), do: false

  @doc "Records the end at `time`; returns `:tell` to report it now, or `:later` if messages are held back (`held?`)."
  @spec record_end(t(), Situ.Time.t(), boolean()) :: {:tell | :later, t()}
  def record_end(%__MODULE__{completed: true, completing: nil} = source, _time, _held?),
    do: {:later, source}

  def record_end(%__MODULE__{} = source, time, true),
    do: {:later, %{source | completing: time, completed: true}}

  def record_end(%__MODULE__{} = source, _time, false),
    do: {:tell, %{source | completing: nil, completed: true}}

  @doc "Requests a stop at `final`."
  @spec request_stop(t(), Situ.Time.t()) :: t()
  def request_stop(%__MODULE__{} = source, final), do: %{source | final: final, stopping: :asked}

  @doc "Marks a source that is stopping and will report when it has stopped."
  @spec mark_stopping(t()) :: t()
  def mark_stopping(%__MODULE__{stopping: :asked} = source), do: %{source | stopping: :stopping}
  def mark_stopping(%__MODULE__{} = source), do: source

  @doc "Marks a source that has posted its last message; `held?` means that some messages are still held back."
  @spec mark_stopped(t(), boolean()) :: {:tell | :later, t()}
  def mark_stopped(%__MODULE__{stopping: :done} = source, _held?), do: {:later, source}
  def mark_stopped(%__MODULE__{} = source, true), do: {:later, %{source | stopping: :held}}
  def mark_stopped(%__MODULE__{} = source, false), do: {:tell, %{source | stopping: :done}}

  @doc """
  Judges a source's response to demand. A source that emitted nothing is asked again after the next event. A source that
  failed is asked again immediately, up to `max_strikes/0` times in a row, because a failure consumes no message.
  """
  @spec judge_reply(t(), emitted? :: boolean(), harmed? :: boolean(), repeated? :: boolean()) ::
          {:ok | :no_way_on, t()}
  def judge_reply(%__MODULE__{} = source, true, _harmed?, _repeated?),
    do: {:ok, %{source | strikes: 0}}

  def judge_reply(%__MODULE__{} = source, false, false, true), do: {:ok, source}
  def judge_reply(%__MODULE__{} = source, false, false, false), do: {:ok, %{source | idle: true}}

  def judge_reply(%__MODULE__{strikes: strikes} = source, false, true, _repeated?)
      when strikes < @strikes,
      do: {:ok, %{source | strikes: strikes + 1}}

  def judge_reply(%__MODULE__{} = source, false, true, _repeated?), do: {:no_way_on, source}

  @doc "Returns how many consecutive errors are too many."
  @spec max_strikes() :: pos_integer()
  def max_strikes, do: @strikes + 1
end
