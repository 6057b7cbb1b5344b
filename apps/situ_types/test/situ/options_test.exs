defmodule Situ.OptionsTest do
  use ExUnit.Case, async: true
  doctest Situ.Options

  test "{:integer, min, max} accepts integers only, and {:range, min, max} any number" do
    schema = [port: [type: {:integer, 1, 65_535}], share: [type: {:range, 0, 1}]]
    assert {:ok, [port: 80, share: 0.5]} = Situ.Options.validate([port: 80, share: 0.5], schema)
    assert {:error, error} = Situ.Options.validate([port: 80.5], schema)
    assert error.code == :bad_option and Exception.message(error) =~ "an integer from 1 to 65535"
  end
end
