defmodule Situ.Dataset.Derivation.Report do
  @moduledoc false
  # Reports on a run over sessions: `output`, `duration` (ns), `cancelled?`, and a result for each
  # session, in the order of the sessions.
  #
  # A result's `status` is `:done`, `:kept` (completed by an earlier, interrupted run), `:failed`
  # (see `error`) or `:cancelled`. `result` is the return value of `build`, and `took` is the time
  # in ns. Sessions that were not started have no result.
  defstruct [:output, results: [], cancelled?: false, duration: 0]

  @type result :: %{
          session: String.t(),
          status: :done | :kept | :failed | :cancelled,
          error: Situ.Error.t() | nil,
          result: term(),
          took: Situ.Time.duration()
        }
  @type t :: %__MODULE__{
          output: String.t() | nil,
          results: [result()],
          cancelled?: boolean(),
          duration: Situ.Time.duration()
        }

  @doc "Returns the failed sessions with their errors."
  @spec failures(t()) :: [{String.t(), Situ.Error.t()}]
  def failures(%__MODULE__{} = report),
    do: for(%{status: :failed} = r <- report.results, do: {r.session, r.error})
end
