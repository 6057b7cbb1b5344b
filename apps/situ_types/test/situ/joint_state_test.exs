defmodule Situ.JointStateTest do
  use ExUnit.Case, async: true
  doctest Situ.JointState

  test "a joint that is not there, or whose position nobody says, has none" do
    {:ok, arm} = Situ.JointState.new(["a"], [], [1.0])
    assert Situ.JointState.position(arm, "a") == nil
    assert Situ.JointState.position(arm, "b") == nil
    assert {:error, %{code: :bad_joints}} = Situ.JointState.new(["a"], [], [1.0, 2.0])
  end
end
