defmodule Situ.Dataset.Derivation.Report do
  @moduledoc false
  # The report of a run over sessions, which `Situ.Dataset.derive/3` describes.
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
