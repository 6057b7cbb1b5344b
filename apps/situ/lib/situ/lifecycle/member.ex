defmodule Situ.Lifecycle.Member do
  @moduledoc false
  # The life cycle's view of one stage.
  #
  #   status   :running, :failed (takes no more messages), :restarting, :closed, :dead (its process has ended), :ended
  #            (stopped as a part of a pipeline that keeps running)
  #   open?    whether its outputs have yet to close
  #   ends_at  the latest closing time among inputs that have closed
  #   limit    the time after which messages of the stage do not count
  #   up?      whether its process has reported its initial state since the last spawn
  #   alive?   whether it has a process
  #   added?   whether it was added to the running pipeline
  #   unit     the composite with which it restarts or ends
  #   again?   whether its process replaced an earlier one to which its neighbours still refer
  @enforce_keys [:id, :path]
  defstruct [
    :id,
    :path,
    :ends_at,
    :limit,
    :unit,
    source?: false,
    tap?: false,
    on_error: :stop,
    status: :running,
    open?: true,
    up?: false,
    alive?: true,
    added?: false,
    again?: false,
    restarts: 0
  ]

  @type t :: %__MODULE__{
          id: pos_integer(),
          path: String.t(),
          ends_at: Situ.Time.t() | nil,
          limit: Situ.Time.t() | nil,
          unit: {String.t(), :restart | :close} | nil,
          source?: boolean(),
          tap?: boolean(),
          on_error: :stop | :skip | :restart,
          status: :running | :failed | :restarting | :closed | :dead | :ended,
          open?: boolean(),
          up?: boolean(),
          alive?: boolean(),
          added?: boolean(),
          again?: boolean(),
          restarts: non_neg_integer()
        }

  @doc "Returns the member of a stopped stage that starts again."
  @spec restart(t()) :: t()
  def restart(%__MODULE__{} = member) do
    kept = Map.take(member, [:id, :path, :unit, :source?, :tap?, :on_error, :added?])
    struct!(__MODULE__, kept)
  end
end
