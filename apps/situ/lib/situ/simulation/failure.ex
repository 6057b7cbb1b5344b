defmodule Situ.Simulation.Failure do
  @moduledoc """
  The failure of a simulation.

  - `kind`: `:raised` (the function raised, exited or threw), `:deadlock` (no process can continue, and the function
    has not returned), or `:endless` (the simulation took more than `max_steps` turns, or one turn does not end).
  - `reason`: the exception, exit reason or thrown value of `:raised`.
  - `processes`: the state of each process for the other kinds.
  - `seed` and `choices`: the schedule. `Situ.Simulation.check/2` sets `choices` for the shrunk schedule.
  """
  alias Situ.Simulation.Result

  # `result.steps` has all of them.
  @most_steps 150

  defexception [
    :kind,
    :reason,
    :stacktrace,
    :seed,
    :result,
    processes: [],
    choices: %{},
    how: :error
  ]

  @type t :: %__MODULE__{
          kind: :raised | :deadlock | :endless,
          reason: term(),
          stacktrace: Exception.stacktrace() | nil,
          seed: integer() | nil,
          result: Result.t() | nil,
          processes: [{String.t(), String.t()}],
          choices: %{pos_integer() => pos_integer()},
          how: :error | :exit | :throw
        }

  @impl true
  def message(%__MODULE__{} = failure) do
    [describe(failure), describe_steps(failure), describe_replay(failure)]
    |> Enum.reject(&(&1 == ""))
    |> Enum.join("\n\n")
  end

  defp describe(%{kind: :raised, how: how, reason: reason, stacktrace: stack}),
    do: "the simulated function failed:\n\n" <> Exception.format(how, reason, stack || [])

  defp describe(%{kind: :deadlock} = failure) do
    "the simulation is deadlocked: no process can continue, and the function has not returned\n" <>
      format_processes(failure)
  end

  defp describe(%{kind: :endless} = failure),
    do:
      "the simulation does not end; raise max_steps: if it only takes long\n" <>
        format_processes(failure)

  defp format_processes(%{processes: processes}),
    do: Enum.map_join(processes, &"\n    #{elem(&1, 0)} #{elem(&1, 1)}")

  defp describe_steps(%{result: nil}), do: ""

  defp describe_steps(%{result: result}),
    do:
      "The steps (* marks the choices against the usual order):\n\n" <>
        Result.format_steps(result, @most_steps)

  defp describe_replay(%{seed: seed, choices: choices}) do
    found = if seed, do: "Found with seed: #{seed}. ", else: ""
    text = inspect(choices, limit: :infinity)
    found <> "To run it again: Situ.Simulation.run(fun, choices: #{text})"
  end
end
