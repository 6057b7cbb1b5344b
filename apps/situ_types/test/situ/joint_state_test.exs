defmodule Situ.JointStateTest do
  use ExUnit.Case, async: true
  doctest Situ.JointState

  test "a missing joint, or a joint without a position, has position nil" do
    {:ok, arm} = Situ.JointState.new(["a"], [], [1.0])
    assert Situ.JointState.joint_position(arm, "a") == nil
    assert Situ.JointState.joint_position(arm, "b") == nil
    assert {:error, %{code: :bad_joints}} = Situ.JointState.new(["a"], [], [1.0, 2.0])
  end
end
