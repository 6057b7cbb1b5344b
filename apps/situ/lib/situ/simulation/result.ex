defmodule Situ.Simulation.Result do
  @moduledoc """
  The result of a simulation, from `Situ.Simulation.run/2`.

  - `value`: the result of the function; `nil` if it failed.
  - `failure`: the `Situ.Simulation.Failure`, or `nil`.
  - `steps`: what happened, in order. The process is the path of a component, the name of a pipeline, or `"test"` for
    the function. A step is `unusual?` if the schedule left the usual course at or just before it.
  - `choices`: the deviations of the schedule from the usual course, which `Situ.Simulation.run/2` replays.
  - `turns`: how often a process had its turn. `time`: how much virtual time has passed, ns.
  """
  @enforce_keys [:value, :failure, :steps, :choices, :turns, :time]
  defstruct [:value, :failure, :steps, :choices, :turns, :time]

  @type step :: %{process: String.t(), event: String.t(), unusual?: boolean()}
  @type t :: %__MODULE__{
          value: term(),
          failure: Situ.Simulation.Failure.t() | nil,
          steps: [step()],
          choices: %{pos_integer() => pos_integer()},
          turns: non_neg_integer(),
          time: Situ.Time.duration()
        }

  @doc """
  Returns the steps as text, one per line; `*` marks the unusual ones. With `most`, only the last ones are listed.
  """
  @spec format_steps(t(), pos_integer() | :infinity) :: String.t()
  def format_steps(%__MODULE__{steps: steps}, most \\ :infinity) do
    # A number is less than any atom.
    omitted = if length(steps) > most, do: length(steps) - most, else: 0

    lines =
      steps |> Enum.with_index(1) |> Enum.drop(omitted) |> Enum.map_join("\n", &format_step/1)

    if omitted > 0, do: "      (#{omitted} earlier steps)\n" <> lines, else: lines
  end

  defp format_step({step, i}) do
    mark = if step.unusual?, do: "*", else: " "
    "#{String.pad_leading("#{i}", 5)} #{mark} #{step.process} #{step.event}"
  end
end
