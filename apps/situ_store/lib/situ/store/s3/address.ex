defmodule Situ.Store.S3.Address do
  @moduledoc false
  # Parses addresses of recordings in object storage: `s3://BUCKET/PREFIX/NAME`.
  alias Situ.Error

  @enforce_keys [:bucket, :key]
  defstruct [:bucket, :key]
  @typedoc "`key` has no slash at its ends, and is empty for the whole bucket."
  @type t :: %__MODULE__{bucket: String.t(), key: String.t()}

  @doc """
  Parses an address.

      iex> Situ.Store.S3.Address.parse("s3://lab/rec/lobby")
      {:ok, %Situ.Store.S3.Address{bucket: "lab", key: "rec/lobby"}}
      iex> {:error, error} = Situ.Store.S3.Address.parse("s3://key:secret@lab/rec")
      iex> error.what
      "this address of object storage contains credentials"
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse("s3://" <> rest = text) do
    [bucket | parts] = rest |> String.trim_trailing("/") |> String.split("/")

    cond do
      String.contains?(bucket, "@") -> {:error, credentials_error()}
      not (bucket =~ ~r/\A[a-zA-Z0-9][a-zA-Z0-9._-]{1,254}\z/) -> {:error, invalid_error(text)}
      Enum.any?(parts, &invalid_part?/1) -> {:error, invalid_error(text)}
      true -> {:ok, %__MODULE__{bucket: bucket, key: Enum.join(parts, "/")}}
    end
  end

  def parse(text), do: {:error, invalid_error(text)}

  defp invalid_part?(part),
    do: part in ["", ".", ".."] or not String.valid?(part) or part =~ ~r/[[:cntrl:]]/u

  # The address itself must not appear in the error.
  defp credentials_error do
    Error.new(:bad_address, "this address of object storage contains credentials",
      why: "addresses appear in logs and in the list of processes",
      fix: "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or write ~/.aws/credentials"
    )
  end

  defp invalid_error(text) do
    Error.new(:bad_address, "#{inspect(text)} is not an address of object storage",
      fix: "write s3://BUCKET/PREFIX/NAME, without empty parts"
    )
  end

  @doc "Returns the address as text."
  @spec format(t()) :: String.t()
  def format(%__MODULE__{bucket: bucket, key: ""}), do: "s3://" <> bucket
  def format(%__MODULE__{bucket: bucket, key: key}), do: "s3://#{bucket}/#{key}"

  @doc "Returns the last part of the key."
  @spec name(t()) :: String.t()
  def name(%__MODULE__{key: ""}), do: ""
  def name(%__MODULE__{key: key}), do: key |> String.split("/") |> List.last()

  @doc "Returns the address of the folder that contains this address."
  @spec parent(t()) :: t()
  def parent(%__MODULE__{key: key} = address),
    do: %{address | key: key |> String.split("/") |> Enum.drop(-1) |> Enum.join("/")}

  @doc "Returns the address of a name in this folder."
  @spec join(t(), String.t()) :: t()
  def join(%__MODULE__{key: ""} = address, name), do: %{address | key: name}
  def join(%__MODULE__{key: key} = address, name), do: %{address | key: key <> "/" <> name}
end
