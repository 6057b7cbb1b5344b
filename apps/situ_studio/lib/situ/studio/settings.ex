defmodule Situ.Studio.Settings do
  @moduledoc """
  The settings of a studio for all its browsers: a JSON file beside the layouts. Missing or invalid values take their
  defaults, so every page opens even with a damaged file. Settings of a single browser stay in that browser.

      iex> folder = Path.join(System.tmp_dir!(), "situ-doc-settings/layouts")
      iex> :ok = Situ.Studio.Settings.save(folder, %Situ.Studio.Settings{info: :size})
      iex> Situ.Studio.Settings.load(folder).info
      :size
      iex> File.rm_rf!(Path.dirname(folder)) != []
      true

  | setting | means | usual |
  |---|---|---|
  | `layout` | the layout a recording opens with, where its address names none | `Automatic` |
  | `keep` | `:by_hand`: a changed layout is saved on request; `:at_once`: with each change; `:ask`: on request, and who leaves the page with changes is asked | `:by_hand` |
  | `info` | beside the streams' names: one of `Situ.Studio.Figures.choices/0` | `:rate` |
  | `alerts` | rules held against running pipelines, one a line (`Situ.Studio.Alerts.Rule`) | none |
  """
  alias Situ.Error
  alias Situ.Studio.Alerts.Rule
  alias Situ.Studio.Layout

  @keeps [:by_hand, :at_once, :ask]
  @infos Keyword.keys(Situ.Studio.Figures.choices())
  @max_bytes 100_000

  defstruct layout: Layout.Auto.name(), keep: :by_hand, info: :rate, alerts: ""

  @type t :: %__MODULE__{
          layout: String.t(),
          keep: :by_hand | :at_once | :ask,
          info: atom(),
          alerts: String.t()
        }

  @doc "The choices of a setting."
  @spec choices(:keep | :info) :: [atom()]
  def choices(:keep), do: @keeps
  def choices(:info), do: @infos

  @doc "The settings beside the folder of the layouts."
  @spec load(Path.t()) :: t()
  def load(layouts) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path(layouts)),
         {:ok, text} <- File.read(path(layouts)),
         {:ok, %{} = given} <- Situ.JSON.decode(text) do
      put(%__MODULE__{}, given)
    else
      _ -> %__MODULE__{}
    end
  end

  @doc """
  With what a form or a file says, as far as it means something.

      iex> Situ.Studio.Settings.put(%Situ.Studio.Settings{}, %{"info" => "count", "keep" => "sometimes"})
      %Situ.Studio.Settings{layout: "Automatic", keep: :by_hand, info: :count, alerts: ""}
  """
  @spec put(t(), map()) :: t()
  def put(%__MODULE__{} = settings, given) do
    layout = given["layout"]

    %{
      settings
      | layout:
          if(is_binary(layout) and String.valid?(layout), do: layout, else: settings.layout),
        keep: one(@keeps, given["keep"], settings.keep),
        info: one(@infos, given["info"], settings.info),
        alerts: alerts(given["alerts"], settings.alerts)
    }
  end

  # Rules that are none are kept out: what a file says by hand may be anything.
  defp alerts(text, usual) when is_binary(text) do
    if String.valid?(text) and match?({:ok, _}, Rule.read(text)), do: text, else: usual
  end

  defp alerts(_, usual), do: usual

  defp one(choices, text, usual), do: Enum.find(choices, usual, &(Atom.to_string(&1) == text))

  @doc "Writes them whole or not at all."
  @spec save(Path.t(), t()) :: :ok | {:error, Error.t()}
  def save(layouts, %__MODULE__{} = settings) do
    path = path(layouts)
    temporary = "#{path}.#{System.unique_integer([:positive])}.tmp"
    text = settings |> Map.from_struct() |> Situ.JSON.encode()

    with :ok <- File.mkdir_p(Path.dirname(path)),
         :ok <- File.write(temporary, text),
         :ok <- File.rename(temporary, path) do
      :ok
    else
      {:error, reason} ->
        _ = File.rm(temporary)

        {:error,
         Error.new(:not_saved, "the settings cannot be saved",
           why: "#{path}: #{:file.format_error(reason)}",
           fix: "make the folder writable, or start the studio with another layouts:"
         )}
    end
  end

  defp path(layouts), do: Path.join(Path.dirname(layouts), "settings.json")
end
