defmodule Situ.Dataset.Derivation.Report do
  @moduledoc """
  How a run over the sessions went: `output`, `duration` (ns), `cancelled?`, and a result for each session, in their
  order.

  A result's `status` is `:done`, `:kept` (an earlier, killed run had done it), `:failed` (`error` says why) or
  `:cancelled`; `result` is what `build` returned, `took` the time in ns. Sessions that were not begun have none.
  """
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

  @doc "The sessions that failed, with their errors."
  @spec failures(t()) :: [{String.t(), Situ.Error.t()}]
  def failures(%__MODULE__{} = report),
    do: for(%{status: :failed} = r <- report.results, do: {r.session, r.error})
end
