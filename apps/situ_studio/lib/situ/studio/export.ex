defmodule Situ.Studio.Export do
  @moduledoc false
  # Exports an interval of a recording, with all or some streams, as a new recording next to it.
  alias Situ.Error
  alias Situ.Studio.Catalog.Item

  @enforce_keys [:name, :from, :to]
  defstruct [:name, :from, :to, streams: :all]

  @type t :: %__MODULE__{
          name: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          streams: :all | [String.t()]
        }

  # Valid on every file system and without a path separator.
  @name ~r/\A[\p{L}\p{N}][\p{L}\p{N} ._-]{0,59}\z/u

  @doc """
  Validates user input and builds an export. Times are in ns and inclusive.

      iex> {:error, error} = Situ.Studio.Export.new("../../etc", 0, 10, :all)
      iex> error.code
      :bad_name
      iex> {:ok, export} = Situ.Studio.Export.new(" talk 2 ", 0, 10, ["Mic"])
      iex> {export.name, Situ.Studio.Export.duration(export)}
      {"talk 2", 10}
  """
  @spec new(String.t(), Situ.Time.t(), Situ.Time.t(), :all | [String.t()]) ::
          {:ok, t()} | {:error, Error.t()}
  def new(name, from, to, streams) do
    name = String.trim(name)

    cond do
      check_name(name) != :ok ->
        check_name(name)

      to <= from ->
        {:error,
         Error.new(:empty, "the selected interval is empty",
           fix: "drag over a timeline while holding Shift to select one"
         )}

      streams == [] ->
        {:error, Error.new(:empty, "no streams are shown", fix: "export all streams")}

      true ->
        {:ok, %__MODULE__{name: name, from: from, to: to, streams: streams}}
    end
  end

  @doc "Checks that a name is a valid file name on every file system and does not leave its folder."
  @spec check_name(String.t()) :: :ok | {:error, Error.t()}
  def check_name(name) do
    if String.valid?(name) and name =~ @name do
      :ok
    else
      {:error,
       Error.new(:bad_name, "#{inspect(name)} is not a valid file name",
         why:
           "a name has 1 to 60 letters, digits, spaces, dots and dashes, and starts with a letter or digit",
         fix: "choose another name"
       )}
    end
  end

  @doc "Returns the duration in ns."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{from: from, to: to}), do: to - from

  @doc "Writes the export next to the recording and returns `{:ok, path}` when all data is copied."
  @spec write_recording(t(), Item.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def write_recording(%__MODULE__{} = export, %Item{kind: :store, path: path}) do
    some = if export.streams == :all, do: [], else: [streams: export.streams]

    Situ.Store.crop(
      path,
      {export.name, Path.dirname(path)},
      [from: export.from, to: export.to] ++ some
    )
  end

  def write_recording(_, %Item{title: title}) do
    {:error, Error.new(:no_store, "#{title} is not a recording on disk", fix: "open a recording")}
  end
end
