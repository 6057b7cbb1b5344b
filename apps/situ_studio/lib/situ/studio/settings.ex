defmodule Situ.Studio.Settings do
  @moduledoc false
  # Stores the settings that all browsers of a studio share, in a JSON file next to the layouts
  # folder. Missing or invalid values fall back to their defaults, so that every page opens even
  # if the file is damaged. Settings of a single browser are stored in that browser.
  #
  # | setting | meaning | default |
  # |---|---|---|
  # | `layout` | the initial layout of a recording whose address does not name one | `Automatic` |
  # | `keep` | when layouts are saved: `:by_hand`, `:at_once`, or `:ask` when a page is closed | `:by_hand` |
  # | `info` | the statistic next to stream names, one of `Situ.Studio.StreamTotals.list_choices/0` | `:rate` |
  # | `alerts` | alert rules for running pipelines, one per line (`Situ.Studio.Alerts.Rule`) | none |
  alias Situ.EditLog.{JsonFormat, Merging}
  alias Situ.Error
  alias Situ.Studio.Alerts.Rule
  alias Situ.Studio.Layout

  @keeps [:by_hand, :at_once, :ask]
  @infos Keyword.keys(Situ.Studio.StreamTotals.list_choices())
  @max_bytes 100_000

  defstruct layout: Layout.Auto.layout_name(), keep: :by_hand, info: :rate, alerts: ""

  @type t :: %__MODULE__{
          layout: String.t(),
          keep: :by_hand | :at_once | :ask,
          info: atom(),
          alerts: String.t()
        }

  @doc "Loads the settings that belong to the folder of layouts."
  @spec load(Path.t()) :: t()
  def load(layouts) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(settings_path(layouts)),
         {:ok, text} <- File.read(settings_path(layouts)),
         {:ok, %{} = json} <- Situ.JSON.decode(text) do
      put_values(%__MODULE__{}, json)
    else
      _ -> %__MODULE__{}
    end
  end

  @doc """
  Updates the settings with the valid values from a form or a file.

      iex> Situ.Studio.Settings.put_values(%Situ.Studio.Settings{}, %{"info" => "count", "keep" => "sometimes"})
      %Situ.Studio.Settings{layout: "Automatic", keep: :by_hand, info: :count, alerts: ""}
  """
  @spec put_values(t(), map()) :: t()
  def put_values(%__MODULE__{} = settings, json) do
    layout = json["layout"]

    %{
      settings
      | layout:
          if(is_binary(layout) and String.valid?(layout), do: layout, else: settings.layout),
        keep: find_choice(@keeps, json["keep"], settings.keep),
        info: find_choice(@infos, json["info"], settings.info),
        alerts: valid_alerts(json["alerts"], settings.alerts)
    }
  end

  # A file that was edited by hand may contain invalid rules, which are ignored.
  defp valid_alerts(text, usual) when is_binary(text) do
    if String.valid?(text) and match?({:ok, _}, Rule.parse_rules(text)), do: text, else: usual
  end

  defp valid_alerts(_, usual), do: usual

  defp find_choice(choices, text, usual),
    do: Enum.find(choices, usual, &(Atom.to_string(&1) == text))

  @doc """
  Saves the settings. `base` are the settings that the caller has changed, so that changes of others remain.

      iex> folder = Path.join(System.tmp_dir!(), "situ-doc-settings/layouts")
      iex> :ok = Situ.Studio.Settings.save(folder, %Situ.Studio.Settings{info: :size})
      iex> Situ.Studio.Settings.load(folder).info
      :size
      iex> File.rm_rf!(Path.dirname(folder)) != []
      true
  """
  @spec save(Path.t(), t(), t() | nil) :: :ok | {:error, Error.t()}
  def save(layouts, %__MODULE__{} = settings, base \\ nil) do
    contents = {base && encode_settings(base), encode_settings(settings)}
    with {:ok, _} <- Merging.save(settings_path(layouts), JsonFormat, contents), do: :ok
  end

  defp encode_settings(settings) do
    {:ok, json} = settings |> Map.from_struct() |> Situ.JSON.encode() |> Situ.JSON.decode()
    json
  end

  defp settings_path(layouts), do: Path.join(Path.dirname(layouts), "settings.json")
end
