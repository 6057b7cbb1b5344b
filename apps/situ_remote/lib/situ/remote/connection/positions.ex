defmodule Situ.Remote.Connection.Positions do
  @moduledoc false
  # The position of each stream of a link. `saved` holds the positions already written to the file. `confirmed` holds
  # the positions confirmed by the pipeline (nil before the first one), which take precedence over merely delivered
  # messages. `left` holds the positions of streams that are no longer subscribed.
  alias Situ.Error
  alias Situ.Remote.Position

  defstruct saved: %{}, confirmed: %{}, left: %{}

  @type t :: %__MODULE__{
          saved: Position.t(),
          confirmed: %{String.t() => Situ.Time.t() | nil},
          left: Position.t()
        }

  @doc "Makes the position of a stream its last confirmed message."
  @spec confirming(t(), String.t()) :: t()
  def confirming(%__MODULE__{} = positions, name),
    do: %{positions | confirmed: Map.put_new(positions.confirmed, name, nil)}

  @spec confirm(t(), String.t(), Situ.Time.t()) :: t()
  def confirm(%__MODULE__{} = positions, name, time),
    do: %{positions | confirmed: Map.put(positions.confirmed, name, time)}

  @doc "Keeps the final position of a stream that is no longer subscribed: messages up to `time` were consumed."
  @spec leave(t(), String.t(), Situ.Time.t() | nil) :: t()
  def leave(%__MODULE__{} = positions, _name, nil), do: positions

  def leave(%__MODULE__{} = positions, name, time),
    do: %{positions | left: Map.put(positions.left, name, time)}

  @doc "Writes changed positions to the file. `taken` holds the positions of the subscribed streams."
  @spec save(t(), Path.t(), [{String.t(), Situ.Time.t() | nil}]) ::
          {:ok | {:error, Error.t()}, t()}
  def save(%__MODULE__{} = positions, path, taken) do
    known = positions.left |> Map.merge(known(taken)) |> Map.merge(positions.confirmed)
    now = Map.merge(positions.saved, known(known))

    if now == positions.saved,
      do: {:ok, positions},
      else: {Position.save(path, now), %{positions | saved: now}}
  end

  defp known(times), do: for({name, time} <- times, time != nil, into: %{}, do: {name, time})
end
