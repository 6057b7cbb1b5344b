defmodule Situ.CLI.New.Name do
  @moduledoc false
  # The name of a project, or of a part of a project, in the forms that files and modules need.
  alias Situ.Error

  @enforce_keys [:file, :module]
  defstruct [:file, :module]

  @type t :: %__MODULE__{file: String.t(), module: String.t()}

  # Applications and modules that exist already, in Elixir or in Situ.
  @reserved ~w(elixir mix eex ex_unit iex logger kernel stdlib situ test)

  @doc """
  Parses a name: lowercase letters, digits, hyphens and underscores. Error: `:bad_name`.

      iex> Situ.CLI.New.Name.parse("blink-detector")
      {:ok, %Situ.CLI.New.Name{file: "blink_detector", module: "BlinkDetector"}}
      iex> {:error, error} = Situ.CLI.New.Name.parse("Blink Detector")
      iex> error.fix
      "use lowercase letters, digits and hyphens, beginning with a letter, such as blink-detector"
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(text) do
    file = String.replace(text, "-", "_")

    cond do
      not (file =~ ~r/\A[a-z][a-z0-9_]{0,39}\z/) ->
        {:error,
         Error.new(:bad_name, "invalid name #{inspect(text)}",
           fix:
             "use lowercase letters, digits and hyphens, beginning with a letter, such as #{suggest(text)}"
         )}

      file in @reserved or String.starts_with?(file, "situ_") ->
        {:error,
         Error.new(:bad_name, "the name #{inspect(text)} is reserved",
           why: "an application or module of Elixir or Situ has this name",
           fix: "choose another name"
         )}

      true ->
        {:ok, %__MODULE__{file: file, module: Macro.camelize(file)}}
    end
  end

  defp suggest(text) do
    words = text |> String.downcase() |> String.replace(~r/[^a-z0-9]+/, "-") |> String.trim("-")
    if words =~ ~r/\A[a-z]/, do: String.slice(words, 0, 40), else: "lobby"
  end
end
