defmodule Situ.CLI.Token do
  @moduledoc false
  # Reads the tokens that verbs need. Every user of the machine can read a process's command line, but not a private
  # file or the process's environment.
  alias Situ.CLI.{Option, Output}
  alias Situ.Error
  alias Situ.Link.Access

  @doc "Returns the option that names the token's file; `doc` describes the option in help."
  @spec token_option(String.t()) :: Option.t()
  def token_option(doc \\ "the file with the token in its first line (or set SITU_TOKEN)"),
    do: Option.new(:token_file, :path, doc)

  @doc """
  Returns the token that was given by `--token-file`, by the older `--token` (with a warning), or by SITU_TOKEN, or
  `nil`. Errors: `:no_token`, `:usage`.
  """
  @spec read_token(keyword()) :: {:ok, String.t() | nil} | {:error, Error.t()}
  def read_token(opts) do
    case {opts[:token_file], opts[:token]} do
      {nil, nil} ->
        {:ok, token_from_environment()}

      {file, nil} ->
        warn_of_readers(file)
        Access.read_token_file(file)

      {nil, token} ->
        Output.warn(
          "situ: every user of this machine can read --token in the process list\n" <>
            "  Fix: write it to a file with mode 0600 and give --token-file FILE, or set SITU_TOKEN"
        )

        {:ok, token}

      _ ->
        {:error,
         Error.new(:usage, "--token and --token-file are both given", fix: "give only one")}
    end
  end

  @doc "Warns if an address contains a password."
  @spec warn_of_password(String.t(), String.t()) :: :ok
  def warn_of_password(address, fix) do
    if URI.parse(address).userinfo != nil do
      Output.warn(
        "situ: every user of this machine can read the password in the address in the process list\n" <>
          "  Fix: #{fix}"
      )
    end

    :ok
  end

  defp token_from_environment do
    case System.get_env("SITU_TOKEN") do
      "" -> nil
      token -> token
    end
  end

  # Access for the group may be intentional; access for all users is not.
  defp warn_of_readers(file) do
    with {:ok, %{mode: mode}} when Bitwise.band(mode, 0o004) != 0 <- File.stat(file) do
      Output.warn(
        "situ: every user of this machine can read #{file}\n  Fix: chmod 600 #{Output.format_name(file)}"
      )
    end
  end
end
